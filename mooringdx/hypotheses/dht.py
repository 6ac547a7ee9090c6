"""Dynamic hypothesis testing: Bayes' rule over rival observers, sample by sample.

    p_i(t) = l_i p_i(t-1) / sum_k l_k p_k(t-1),   l_i = N(y~_i; 0, S_i)   [PositionThesis, eqs. 3.27, 3.28]
    p <- max(p, floor) / sum max(p, floor)                                               [PositionThesis, section 4.6.2]

y~_i: the innovation of observer i, S_i its second moment. Carried in logarithms, so that no likelihood underflows.
``temper`` divides the exponents, because innovations of one wave are no independent witnesses. ``transition`` mixes
the probabilities before every sample, p <- Pi' p, which is the weighing step of an interacting-multiple-model bank; the
floor is such a mixing in disguise. The covariance is "printed", cov(y~) + R, in which R counts twice and the mean is
taken out although a mean innovation is what betrays a wrong hypothesis, or "mended", the second moment about zero.

What it cannot see: a truth outside its hypotheses; it then believes the nearest one without a doubt.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mooringdx.errors import FitError
from mooringdx.types import Array

FLOOR = {"text": 1e-9, "listing": 1e-12}


def covariance(error: Array, equations: str = "mended", measurement: Array | None = None) -> Array:
    """Return the covariance, (3, 3), of an innovation, (n, 3), that is to stand for its hypothesis.

    ``measurement``: (3,), variances R, added where ``equations`` is "printed". Raise FitError for under 10 samples.
    """
    seen = error[np.isfinite(error).all(axis=1)]
    if len(seen) < 10:
        raise FitError(f"an innovation of {len(seen)} samples has no covariance; give at least 10")
    if equations == "printed":
        return np.asarray(np.cov(seen.T) + np.diag(np.zeros(3) if measurement is None else measurement))
    return np.asarray(seen.T @ seen / len(seen))


def weights(covariances: Array) -> tuple[Array, Array]:
    """Return the inverses, (h, 3, 3), and ln det, (h,), of covariances, (h, 3, 3)."""
    sign, logdet = np.linalg.slogdet(covariances)
    if not (sign > 0.0).all():
        raise FitError("a hypothesis' innovation covariance is singular; give a longer record, or one with noise")
    return np.asarray(np.linalg.inv(covariances), dtype=np.float64), np.asarray(logdet, dtype=np.float64)


def dht(
    innovation: Array,
    covariances: Array,
    floor: float = FLOOR["text"],
    start: Array | None = None,
    temper: float = 1.0,
    transition: Array | None = None,
) -> Array:
    """Return the probability of every hypothesis after every sample, (n, h), rows that sum to one.

    Parameters
    ----------
    innovation : (n, h, 3), one innovation a hypothesis; a row with a NaN leaves the probabilities as they are.
    covariances : (h, 3, 3), of each innovation when its hypothesis holds.
    floor : the least probability, before renormalising; 0 for none.
    start : (h,), probabilities before the first sample; equal when None.
    temper : divides the log-likelihoods; 1 trusts every sample.
    transition : (h, h), probability to pass from row to column within a sample; none when None.
    """
    inverse, logdet = weights(covariances)
    h = len(covariances)
    p = np.full(h, 1.0 / h) if start is None else np.array(start, dtype=np.float64)
    pi = np.zeros((0, 0)) if transition is None else np.asarray(transition, dtype=np.float64)
    out: Array = _weighed(np.ascontiguousarray(innovation), inverse, logdet, floor, p, 1.0 / temper, pi)
    return out


@njit(cache=True)
def _weighed(
    innovation: Array, inverse: Array, logdet: Array, floor: float, p: Array, power: float, pi: Array
) -> Array:
    n, h = innovation.shape[0], innovation.shape[1]
    out, log = np.empty((n, h)), np.empty(h)
    for k in range(n):
        if pi.size:
            p = pi.T @ p
        whole, most = True, -np.inf
        for i in range(h):
            square = 0.0
            for a in range(3):
                for b in range(3):
                    square += innovation[k, i, a] * inverse[i, a, b] * innovation[k, i, b]
            whole = whole and np.isfinite(square)
            log[i] = -0.5 * power * (square + logdet[i]) + (np.log(p[i]) if p[i] > 0.0 else -np.inf)
            most = max(most, log[i])
        if whole:
            total = 0.0
            for i in range(h):
                p[i] = np.exp(log[i] - most)
                total += p[i]
            rest = 0.0
            for i in range(h):
                p[i] = max(p[i] / total, floor)
                rest += p[i]
            for i in range(h):
                p[i] /= rest
        out[k] = p
    return out
