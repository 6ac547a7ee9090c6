"""Whiten residuals sample by sample, and carry the fault signatures through the same filter.

    x(k) = F(q)/C(q) (r(k) - mean) / sd            [Fang2015, eq. 8], sd that of the innovation
    z(k) = compressed x(k)                         [Fang2015, eq. 9]

The paper filters the residual but not the signature. A step of size d in the residual becomes d times the step
response of F/C, divided by sd: a transient, then F(1)/C(1) d / sd, which is what the mapped signature states (times
the compression's slope for small d).

The filter starts anew after each masked sample: the first p values are its past; the q innovations before are
estimated by least squares from the samples of the start, which stay masked until the error that is left has died to
3 % of the innovation's sd, or for 20 peak periods, whichever is sooner. (Taking the unknown ones as zero leaves an
error that a root near the unit circle carries for minutes: it raised false alarms at the start of a record.) What
it cannot see: a fault of which F(1)/C(1) leaves nothing (a residual with a pole at zero frequency), and anything
between two masked samples closer than that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numba import njit

from mooringdx.config import Compression
from mooringdx.errors import FitError
from mooringdx.registry import did_you_mean
from mooringdx.types import Array, Mask, Residuals, Signatures, Whitened, locked
from mooringdx.whiten.arma import Arma, fit_arma, step_response
from mooringdx.whiten.compress import Compressor, fit_compression
from mooringdx.whiten.squares import Order

Kind = Literal["none", "arma", "arma+compression"]
KINDS: tuple[Kind, ...] = ("none", "arma", "arma+compression")
Piece = tuple[Residuals, slice]
"""A stretch of no-fault samples: a log's residuals and the rows that count."""


@dataclass(frozen=True)
class Whitener:
    """A fitted whitening of r residuals: residuals in, unit-variance (or compressed) values out. Causal.

    ``centre``: (r,), no-fault mean; ``scale``: (r,), sd of the residual ("none") or of its innovation, both in the
    residual's unit. ``models``: r of them, none for kind "none". ``settle``: samples masked after a filter starts.
    """

    kind: Kind
    names: tuple[str, ...]
    centre: Array
    scale: Array
    models: tuple[Arma, ...] = ()
    compression: Compressor | None = None
    settle: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", locked(self.centre))
        object.__setattr__(self, "scale", locked(self.scale))

    @property
    def gain(self) -> Array:
        """(r,), change of the settled output's mean per unit of a small lasting change in the residual's mean."""
        gain = np.array([m.dc_gain for m in self.models]) if self.models else np.ones(len(self.names))
        return np.asarray(gain / self.scale * (self.compression.slope if self.compression else 1.0))

    def __call__(self, residuals: Residuals) -> Whitened:
        """Return the whitened residuals, NaN and not valid where masked or not yet settled."""
        if residuals.names != self.names:
            raise FitError(f"fitted for the residuals {', '.join(self.names)}, got {', '.join(residuals.names)}")
        valid = residuals.valid & np.isfinite(residuals.values)
        z, settled = np.full(valid.shape, np.nan), valid.copy()
        for i in range(len(self.names)):
            if self.models:
                z[:, i], settled[:, i] = self._filter(i, residuals.values[:, i], valid[:, i])
            else:
                z[valid[:, i], i] = (residuals.values[valid[:, i], i] - self.centre[i]) / self.scale[i]
        if self.compression is not None:
            z = self.compression(z)
        return Whitened(
            names=self.names,
            grid=residuals.grid,
            values=z,
            valid=settled,
            signatures=self.mapped(residuals.signatures),
            kind=self.kind,
        )

    def mapped(self, signatures: Signatures) -> Signatures:
        """Return the signatures in whitened units per unit of size, once the filter has settled."""
        return replace(signatures, matrix=signatures.matrix * self.gain)

    def uncompressed(self) -> Whitener:
        """Return the same whitening without compression, for large faults and for sizes."""
        return replace(self, kind="arma", compression=None) if self.compression else self

    def step_response(self, n: int) -> Array:
        """Return (n, r), the uncompressed output's answer to a unit step in each residual at sample 0."""
        if not self.models:
            return np.broadcast_to(1.0 / self.scale, (n, len(self.names))).copy()
        return np.stack([step_response(m, n) for m in self.models], axis=1) / self.scale

    def to_dict(self) -> dict[str, Any]:
        """Return plain lists and numbers; floats come back exactly through JSON."""
        return {
            "kind": self.kind,
            "names": list(self.names),
            "centre": self.centre.tolist(),
            "scale": self.scale.tolist(),
            "settle": list(self.settle),
            "models": [_model_dict(m) for m in self.models],
            "compression": None
            if self.compression is None
            else {
                "kind": self.compression.kind,
                "k": self.compression.k,
                "scale": self.compression.scale.tolist(),
                "slope": self.compression.slope.tolist(),
            },
        }

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> Whitener:
        """Return the whitener that ``to_dict`` described."""
        law = body["compression"]
        return cls(
            kind=body["kind"],
            names=tuple(body["names"]),
            centre=np.array(body["centre"], dtype=np.float64),
            scale=np.array(body["scale"], dtype=np.float64),
            settle=tuple(body["settle"]),
            models=tuple(_model_from(m) for m in body["models"]),
            compression=None
            if law is None
            else Compressor(law["kind"], law["k"], np.array(law["scale"]), np.array(law["slope"])),
        )

    def _filter(self, i: int, values: Array, valid: Mask) -> tuple[Array, Mask]:
        model = self.models[i]
        centred = np.where(valid, values, self.centre[i]) - self.centre[i]
        z, ok = whitened_column(centred, valid, model.ar, model.ma, 1.0 / self.scale[i], self.settle[i])
        return np.asarray(z), np.asarray(ok)


def fit_whitener(
    pieces: Sequence[Piece],
    kind: Kind = "arma",
    order: Order | Literal["bic"] = "bic",
    compression: Compression | None = None,
    peak_period: float | None = None,
    settle: int | None = None,
    start: Whitener | None = None,
) -> Whitener:
    """Fit the whitening of all residuals on no-fault pieces, several logs pooled.

    Parameters
    ----------
    pieces : (residuals, rows) pairs of the same residuals, one or more a log; masked samples split them.
    kind : "none" (mean and sd only), "arma", or "arma+compression".
    order : (p, q), or "bic"; ignored for "none".
    compression : law and k of the tails, for "arma+compression" (Fang's with k = 3 when left out).
    peak_period : s, of the waves; at most 20 of them are masked after a filter starts.
    settle : samples, at most this many are masked after a filter starts, in place of 20 peak periods.
    start : a whitener of similar data: its orders are kept and its coefficients started from, which saves time.

    Raises
    ------
    FitError : a residual cannot be whitened; the message names it.
    """
    if kind not in KINDS:
        raise FitError(f"unknown whitening '{kind}'{did_you_mean(kind, KINDS)}")
    first = pieces[0][0]
    names = first.names
    models: list[Arma] = []
    centre, scale = np.zeros(len(names)), np.ones(len(names))
    for i, name in enumerate(names):
        records = _column(pieces, i)
        before = start.models[i] if start is not None and start.models else None
        try:
            if kind == "none":
                centre[i], scale[i] = _mean_and_sd(records)
            else:
                models.append(fit_arma(records, before.order if before else order, before))
                centre[i], scale[i] = models[-1].mean, models[-1].sd
        except FitError as error:
            raise FitError(f"residual {name}: {error}") from None
    if settle is None and peak_period is not None:
        settle = round(20.0 * peak_period / first.grid.sample_time)
    waits = tuple(settling(m, settle) for m in models)
    whitener = Whitener("none" if kind == "none" else "arma", names, centre, scale, tuple(models), None, waits)
    return compressed(whitener, pieces, compression) if kind == "arma+compression" else whitener


def compressed(whitener: Whitener, pieces: Sequence[Piece], law: Compression | None = None) -> Whitener:
    """Return a fitted ARMA whitening with compression fitted on its output over the no-fault pieces."""
    law = law or Compression()
    if law.kind == "none":
        return whitener
    logs = {id(r): whitener(r).values for r, _ in pieces}
    columns = [np.concatenate([logs[id(r)][rows, i] for r, rows in pieces]) for i in range(len(whitener.names))]
    fitted = fit_compression(columns, law.kind, law.k)
    return replace(whitener, kind="arma+compression", compression=fitted)


def settling(model: Arma, limit: int | None = None) -> int:
    """Return the samples of a start: until the error it leaves is 3 % of the innovation's sd, at most ``limit``.

    The unknown past innovations e(p-1) ... e(p-q) are estimated from the samples so far, each with the innovation's
    sd as its prior; the error is the sd of what their posterior does to later samples through 1/C.
    """
    p, q = model.order
    if q == 0:
        return p
    longest = 20_000 if limit is None else limit
    response = start_responses(model.ma, max(longest - p, 1))
    gram = np.eye(q)
    for n in range(len(response)):
        gram += np.outer(response[n], response[n])
        if n % 8 == 7 and response[n] @ np.linalg.solve(gram, response[n]) < 0.03**2:
            return max(p, min(longest, p + n + 1))
    return max(p, longest)


def _column(pieces: Sequence[Piece], i: int) -> list[Array]:
    """Return one residual's records, NaN where masked."""
    return [np.where(r.valid[rows, i], r.values[rows, i], np.nan) for r, rows in pieces]


def _mean_and_sd(records: Sequence[Array]) -> tuple[float, float]:
    x = np.concatenate(records)
    x = x[np.isfinite(x)]
    if len(x) < 2 or not x.std() > 1e-10 * np.max(np.abs(x)) + 1e-300:
        raise FitError("the no-fault samples are constant or missing; leave this residual out or move the window")
    return float(x.mean()), float(x.std(ddof=1))


def _model_dict(model: Arma) -> dict[str, Any]:
    return {
        "ar": model.ar.tolist(),
        "ma": model.ma.tolist(),
        "mean": model.mean,
        "sd": model.sd,
        "n": model.n,
        "loglik": model.loglik,
        "bic": model.bic,
        "covariance": None if model.covariance is None else model.covariance.tolist(),
    }


def _model_from(body: Mapping[str, Any]) -> Arma:
    covariance = body["covariance"]
    return Arma(
        ar=np.array(body["ar"], dtype=np.float64),
        ma=np.array(body["ma"], dtype=np.float64),
        mean=body["mean"],
        sd=body["sd"],
        n=body["n"],
        loglik=body["loglik"],
        bic=body["bic"],
        covariance=None if covariance is None else np.array(covariance, dtype=np.float64),
    )


@njit(cache=True)
def whitened_column(values: Array, valid: Mask, ar: Array, ma: Array, gain: float, settle: int) -> tuple[Array, Mask]:
    """Return gain F/C applied to (n,) centred values, NaN where masked, and which of the output has settled.

    The filter starts anew after each masked sample, with p values of past. Its ``settle`` first samples are masked and
    serve to estimate the q innovations before them, by least squares with a prior of one innovation each.
    """
    n, p, q = values.size, ar.size, ma.size
    e = np.zeros(n)
    out = np.full(n, np.nan)
    ok = np.zeros(n, dtype=np.bool_)
    response = start_responses(ma, max(settle - p, 1))
    gram = np.eye(q) + response.T @ response
    since = 0
    for k in range(n):
        if not valid[k]:
            since = 0
            continue
        if since == settle and settle > p and q > 0:
            first = k - settle + p
            past = np.linalg.solve(gram, response.T @ e[first:k])
            e[first:k] -= response @ past
        if since >= p:
            total = values[k]
            for i in range(p):
                total += ar[i] * values[k - 1 - i]
            for j in range(min(q, since - p)):
                total -= ma[j] * e[k - 1 - j]
            e[k] = total
            if since >= settle:
                out[k] = total * gain
                ok[k] = True
        since += 1
    return out, ok


@njit(cache=True)
def start_responses(ma: Array, n: int) -> Array:
    """Return (n, q): what a unit innovation at sample -1-j does to the later ones through 1/C."""
    q = ma.size
    response = np.zeros((n, q))
    past = np.zeros(n + q)
    for unknown in range(q):
        past[:] = 0.0
        past[q - 1 - unknown] = 1.0
        for k in range(n):
            total = 0.0
            for j in range(q):
                total -= ma[j] * past[q + k - 1 - j]
            past[q + k] = total
            response[k, unknown] = total
    return response
