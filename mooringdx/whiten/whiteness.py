"""Say how white a residual is, as effect sizes.

    LB/N = (N + 2) sum_{l=1..L} rho_l^2 / (N - l)                   [LjungBox1978], divided by N

The test itself rejects any real record once N passes some thousands, so its p-value is given and decides nothing.
What breaks a window detector is not the marginal law but correlation that outlasts the window: for that look at the
ratio of M var(mean of M samples) to var, which is 1 for white data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mooringdx.types import Array, locked


@dataclass(frozen=True)
class Whiteness:
    """Effect sizes of one residual. ``acf``: (panel_lags + 1,), 1 at lag 0.

    ``ljung_box``: LB over ``lags`` lags, divided by the samples; ``p_value``: of that test, for the record only;
    ``max_acf``: largest |acf| over the same lags; ``window_ratio``: M var(mean_M)/var, NaN with fewer than 8 windows.
    """

    samples: int
    lags: int
    window: int
    ljung_box: float
    p_value: float
    max_acf: float
    window_ratio: float
    excess_kurtosis: float
    acf: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "acf", locked(self.acf))


def whiteness(segments: Sequence[Array], lags: int = 20, window: int = 150, panel_lags: int | None = None) -> Whiteness:
    """Return the effect sizes of one residual over its no-fault records.

    Parameters
    ----------
    segments : records, each (n_i,), any unit; NaN where masked.
    lags : Ljung-Box and largest correlation over lags 1 ... ``lags``; two peak periods see the waves.
    window : the detector's window M, samples.
    panel_lags : length of ``acf``; ``lags`` when left out.
    """
    acf = autocorrelation(segments, max(lags, panel_lags or 0))
    x = np.concatenate([s[np.isfinite(s)] for s in segments])
    n, rho = len(x), acf[1 : lags + 1]
    box = float((n + 2) * np.sum(rho**2 / np.maximum(n - np.arange(1, lags + 1), 1)))
    centred = x - x.mean()
    power = float(np.mean(centred**2))
    return Whiteness(
        samples=n,
        lags=lags,
        window=window,
        ljung_box=box,
        p_value=_chi_square_tail(box * n, lags),
        max_acf=float(np.max(np.abs(rho))),
        window_ratio=_window_ratio(segments, window, float(x.mean()), power),
        excess_kurtosis=float(np.mean(centred**4)) / power**2 - 3.0,
        acf=acf[: (panel_lags or lags) + 1],
    )


def autocorrelation(segments: Sequence[Array], lags: int) -> Array:
    """Return (lags + 1,), the autocorrelation of records about their common mean, by FFT.

    ``segments``: each (n_i,), NaN where masked. Pairs that span a masked sample or two records are left out; without
    any of those it is the usual biased estimate, sum x(k) x(k+l) / sum x(k)^2.
    """
    finite = [np.isfinite(s) for s in segments]
    n = int(sum(f.sum() for f in finite))
    mean = sum(float(s[f].sum()) for s, f in zip(segments, finite, strict=True)) / max(n, 1)
    products, pairs = np.zeros(lags + 1), np.zeros(lags + 1)
    for segment, there in zip(segments, finite, strict=True):
        products += _correlation(np.where(there, segment - mean, 0.0), lags)
        pairs += np.round(_correlation(there.astype(np.float64), lags))
    whole = np.maximum(n - np.arange(lags + 1), 0)
    share = np.divide(whole, pairs, out=np.zeros(lags + 1), where=pairs > 0)
    return np.asarray(products * share / products[0] if products[0] > 0 else np.full(lags + 1, np.nan))


def _correlation(x: Array, lags: int) -> Array:
    """Return sums of x(k) x(k+l), l = 0 ... lags, padded so that nothing wraps round."""
    size = 1 << (len(x) + lags).bit_length()
    spectrum = np.fft.rfft(x, size)
    return np.asarray(np.fft.irfft(spectrum * np.conj(spectrum), size)[: lags + 1])


def _window_ratio(segments: Sequence[Array], window: int, mean: float, power: float) -> float:
    """Return M var(mean_M)/var over the whole windows that hold no masked sample."""
    blocks = [s[: len(s) // window * window].reshape(-1, window) - mean for s in segments]
    means = np.concatenate([b.mean(axis=1) for b in blocks])
    means = means[np.isfinite(means)]
    return float(window * means.var(ddof=1) / power) if len(means) >= 8 and power > 0 else float("nan")


def _chi_square_tail(value: float, degrees: int) -> float:
    from scipy.special import gammaincc

    return float(gammaincc(degrees / 2.0, value / 2.0))
