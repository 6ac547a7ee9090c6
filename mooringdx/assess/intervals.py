"""Exact intervals for what a finite number of cases can say.

binomial, k of n:  [B^-1(a/2; k, n-k+1), B^-1(1-a/2; k+1, n-k)]             Clopper and Pearson, Biometrika 26, 1934
Poisson, k in t:   [chi2^-1(a/2; 2k)/(2t), chi2^-1(1-a/2; 2k+2)/(2t)]       Garwood, Biometrika 28, 1936
"""

from __future__ import annotations


def binomial(count: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Return the exact interval of a share of which ``count`` of ``n`` cases were seen; [0, 1] for no case."""
    from scipy.special import betaincinv

    tail = (1.0 - level) / 2.0
    low = float(betaincinv(count, n - count + 1, tail)) if count > 0 else 0.0
    high = float(betaincinv(count + 1, n - count, 1.0 - tail)) if count < n else 1.0
    return low, high


def poisson(count: int, exposure: float, level: float = 0.95) -> tuple[float, float]:
    """Return the exact interval of a rate from ``count`` events in ``exposure``, per unit of exposure."""
    from scipy.special import gammaincinv

    tail = (1.0 - level) / 2.0
    low = float(gammaincinv(count, tail)) if count > 0 else 0.0
    return low / exposure, float(gammaincinv(count + 1, 1.0 - tail)) / exposure
