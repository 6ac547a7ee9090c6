"""Whitening: identify the colour of each residual, take it out, compress the tails, and say how white the rest is."""

from mooringdx.whiten.arma import ORDERS, Arma, Order, fit_arma, step_response
from mooringdx.whiten.compress import Compressor, fit_compression, fixed_point
from mooringdx.whiten.whitener import KINDS, Kind, Whitener, compressed, fit_whitener, settling
from mooringdx.whiten.whiteness import Whiteness, autocorrelation, whiteness

__all__ = [
    "KINDS",
    "ORDERS",
    "Arma",
    "Compressor",
    "Kind",
    "Order",
    "Whitener",
    "Whiteness",
    "autocorrelation",
    "compressed",
    "fit_arma",
    "fit_compression",
    "fit_whitener",
    "fixed_point",
    "settling",
    "step_response",
    "whiteness",
]
