"""Maximum likelihood with forgetting: the hypothesis whose innovations have lately been least surprising.

    J_i(t) = 1/2 (ln det S_i + y~_i' S_i^-1 y~_i)   [PositionThesis, eqs. 3.35, 4.9]
    mended:   K_i(t) = c K_i(t-1) + J_i(t),  memory Ts/(1 - c)                     [PositionThesis, listing A.2]
    printed:  K_i(t) = c sum_{s<t} J_i(s) + J_i(t)                                       [PositionThesis, eq. 4.10]

The likeliest hypothesis has the least K. As printed the sum itself never forgets, c only shades it; the program behind
the figures is recursive, which is what the text describes. S' in the printed exponents is read as S^-1.

What it cannot see: it ranks and does not say how sure it is, and a new truth must outlast the memory of the old one.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mooringdx.hypotheses.dht import weights
from mooringdx.types import Array

FORGETTING = {"text": 0.999, "listing": 0.99}


def mle(
    innovation: Array,
    covariances: Array,
    forgetting: float = FORGETTING["text"],
    equations: str = "mended",
    start: Array | None = None,
) -> Array:
    """Return the negative log-likelihood K of every hypothesis after every sample, (n, h).

    ``innovation``: (n, h, 3); a row with a NaN leaves K as it is. ``covariances``: (h, 3, 3). ``forgetting``: c.
    ``start``: (h,), the sum before the first sample, K itself as mended; zero when None.
    """
    inverse, logdet = weights(covariances)
    total = np.zeros(len(covariances)) if start is None else np.array(start, dtype=np.float64)
    out: Array = _summed(np.ascontiguousarray(innovation), inverse, logdet, forgetting, equations == "printed", total)
    return out


@njit(cache=True)
def _summed(innovation: Array, inverse: Array, logdet: Array, keep: float, printed: bool, total: Array) -> Array:
    n, h = innovation.shape[0], innovation.shape[1]
    out, new = np.zeros((n, h)), np.empty(h)
    for k in range(n):
        whole = True
        for i in range(h):
            square = 0.0
            for a in range(3):
                for b in range(3):
                    square += innovation[k, i, a] * inverse[i, a, b] * innovation[k, i, b]
            whole = whole and np.isfinite(square)
            new[i] = 0.5 * (square + logdet[i])
        for i in range(h):
            if not whole:
                out[k, i] = out[k - 1, i] if k else total[i]
                continue
            out[k, i] = keep * total[i] + new[i]
            total[i] = total[i] + new[i] if printed else out[k, i]
    return out
