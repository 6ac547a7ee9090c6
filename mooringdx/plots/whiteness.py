"""Is a residual white and Gaussian when nothing is wrong? The panels of [Fang2015, fig. 3-7], before and after.

Autocorrelation at lag k over valid pairs only: rho_k = sum_i x_i x_(i+k) / sum_i x_i^2, x about its mean and
zero where masked, both sums scaled by their numbers of pairs; white noise stays within +-1.96/sqrt(N).
"""

from __future__ import annotations

from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from mooringdx.plots import canvas
from mooringdx.plots.suspects import residual_order
from mooringdx.types import Array, Detection

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LAGS = 150
PANELS = 16
MOST = 1 << 17
LEVELS = (0.0001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.9999)


def parts(detection: Detection) -> tuple[str, ...]:
    """Return up to 16 residuals with at least 50 valid no-fault samples, those of the events first."""
    found = detection.residuals
    if found is None:
        return ()
    first, rest = residual_order(detection)
    mask = canvas.quiet(detection)
    enough = [n for n in first + rest if found.valid[mask, found.names.index(n)].sum() >= 50]
    return tuple(enough[:PANELS])


def autocorrelation(values: Array, lags: int) -> Array:
    """Return rho_0 ... rho_lags of a series with gaps. ``values``: (n,), NaN where masked."""
    ok = np.isfinite(values)
    x = np.where(ok, values - values[ok].mean(), 0.0)
    size = 1 << int(np.ceil(np.log2(x.size + lags + 1)))

    def products(series: Array) -> Array:
        spectrum = np.fft.rfft(series, size)
        return np.asarray(np.fft.irfft(spectrum * spectrum.conj(), size)[: lags + 1])

    pairs = np.maximum(products(ok.astype(np.float64)), 1.0)
    covariance = products(x) / pairs
    return np.asarray(covariance / covariance[0] if covariance[0] > 0 else covariance)


def gaussian_plot(values: Array, points: int = 300) -> tuple[Array, Array]:
    """Return (quantile of the sample, normal score), each (k,); a straight line when Gaussian."""
    ordered = np.sort(values[np.isfinite(values)])
    n = ordered.size
    normal = NormalDist()
    edge = normal.inv_cdf(0.5 / n)
    scores = np.linspace(edge, -edge, min(points, n))
    probability = np.array([normal.cdf(s) for s in scores])
    index = np.clip(np.round(probability * n - 0.5).astype(int), 0, n - 1)
    index, first = np.unique(index, return_index=True)
    exact = np.array([normal.inv_cdf((i + 0.5) / n) for i in index])
    return ordered[index], exact if exact.size else scores[first]


def draw(detection: Detection, name: str) -> Figure:
    """Draw time history, distribution, autocorrelation and Gaussian plot: raw above, whitened below."""
    raw = detection.residuals
    assert raw is not None
    i = raw.names.index(name)
    factor, unit = canvas.display(raw.units[i], raw.values[:, i])
    rows = [(f"raw ({unit})", factor * raw.values[:, i])]
    white = detection.whitened
    if white is not None and name in white.names:
        rows.append(("whitened (-)", np.asarray(white.values[:, white.names.index(name)])))
    height = 0.9 + 2.0 * len(rows)
    edges = {
        "left": 0.07,
        "right": 0.975,
        "bottom": 0.5 / height,
        "top": 1 - 0.28 / height,
        "wspace": 0.46,
        "hspace": 0.36,
    }
    figure, axes = canvas.sheet(10.0, height, edges, nrows=len(rows), ncols=4, width_ratios=[1.5, 0.95, 1.1, 1.05])
    for line, (label, values) in zip(axes, rows, strict=True):
        calm = values[canvas.quiet(detection)][-MOST:]
        if np.isfinite(calm).sum() >= 50:
            _row(line, detection, values, calm, label)
    for panel, title in zip(
        axes[0], ("Time history", "Distribution", "Autocorrelation", "Gaussian probability"), strict=True
    ):
        panel.set_title(title)
    return figure


def _row(line: Array, detection: Detection, values: Array, calm: Array, label: str) -> None:
    grid = detection.channels.grid
    at = canvas.clock(grid)
    line[0].plot(*canvas.envelope(at(grid.time), values, 700), color=canvas.BLUE, lw=0.7)
    canvas.shade(line[0], detection, at)
    line[0].margins(x=0.0)
    line[0].set_ylabel(label)
    at.dress(line[0])
    line[0].locator_params(axis="x", nbins=5) if at.epoch_days is None else None
    _histogram(line[1], detection, values, calm, label)
    lags = min(LAGS, calm.size // 3)
    rho = autocorrelation(calm, lags)
    per, unit = (86400.0, "d") if grid.sample_time >= 7200 else (1.0, "s")
    line[2].axhspan(*(np.array([-1.96, 1.96]) / np.sqrt(np.isfinite(calm).sum())), color=canvas.QUIET, lw=0)
    line[2].axhline(0.0, color=canvas.FAINT, lw=0.8)
    line[2].plot(np.arange(lags + 1) * grid.sample_time / per, rho, color=canvas.BLUE)
    line[2].set_ylim(-1.08, 1.08)
    line[2].set_yticks([-1.0, 0.0, 1.0])
    line[2].set_xlabel(f"lag ({unit})")
    line[2].set_ylabel("correlation (-)")
    _probability(line[3], calm, label)


def _histogram(panel: Axes, detection: Detection, values: Array, calm: Array, label: str) -> None:
    """Draw the densities before and, when there is an event that stands, after its onset."""
    kinds = [(calm[np.isfinite(calm)], canvas.BLUE, "no fault")]
    lead = min(detection.events, key=lambda e: e.onset, default=None)
    if lead is not None:
        grid = detection.channels.grid
        stop = grid.n if lead.cleared is None else grid.index(lead.cleared)
        late = values[grid.index(lead.onset) : stop][:MOST]
        kinds.append((late[np.isfinite(late)], canvas.ORANGE, "in event"))
    kinds = [kind for kind in kinds if kind[0].size >= 10]
    low = min(float(np.quantile(v, 0.0005)) for v, _, _ in kinds)
    high = max(float(np.quantile(v, 0.9995)) for v, _, _ in kinds)
    edges = np.linspace(low, high if high > low else low + 1.0, 61)
    for sample, colour, name in kinds:
        count, _ = np.histogram(sample, edges)
        density = count / max(count.sum(), 1) / np.diff(edges)
        panel.stairs(density, edges, color=colour, lw=1.1, fill=False, label=name)
    panel.set_xlabel(label)
    panel.set_ylabel(f"density (1/{_unit(label)})" if _unit(label) != "-" else "density (-)")
    panel.set_ylim(0.0, 1.45 * panel.get_ylim()[1])
    panel.locator_params(nbins=4)
    panel.legend(loc="upper left", handlelength=1.0, borderaxespad=0.1, fontsize=7.5)


def _unit(label: str) -> str:
    return label[label.index("(") + 1 : -1]


def _probability(panel: Axes, calm: Array, label: str) -> None:
    x, score = gaussian_plot(calm)
    panel.plot(x, score, ".", ms=2.5, color=canvas.BLUE)
    low, high = np.quantile(calm[np.isfinite(calm)], [0.25, 0.75])
    centre, spread = 0.5 * (low + high), (high - low) / 1.349
    if spread > 0:
        reach = np.array([score[0], score[-1]])
        panel.plot(centre + spread * reach, reach, color=canvas.INK, lw=1.0, ls="--", zorder=1)
    normal = NormalDist()
    shown = [p for p in LEVELS if score[0] - 0.3 <= normal.inv_cdf(p) <= score[-1] + 0.3]
    panel.set_yticks([normal.inv_cdf(p) for p in shown], [f"{p:g}" for p in shown])
    panel.set_ylim(score[0] - 0.3, score[-1] + 0.3)
    panel.set_xlabel(label)
    panel.set_ylabel("probability (-)")
    panel.locator_params(axis="x", nbins=3)


def caption(detection: Detection, name: str) -> str:
    """Say what to look at in the panels."""
    raw = detection.residuals
    assert raw is not None
    words = f"Residual {name.replace('_', ' ')}, judged on {canvas.quiet_words(detection)}."
    white = detection.whitened
    if white is not None and name in white.names:
        words += f" Above: raw; below: after the whitening stage ({white.kind})."
    words += (
        " A white residual stays inside the shaded band of the autocorrelation beyond lag zero;"
        " a Gaussian one follows the dashed line of the probability plot. Waves show as an oscillating correlation."
    )
    if int(canvas.quiet(detection).sum()) > MOST:
        words += f" Judged on the last {MOST:,} no-fault samples."
    return words
