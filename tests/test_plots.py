"""Figures of a detection: nothing cut off, units on every axis, every extreme kept, same bytes twice."""

from __future__ import annotations

import subprocess
import sys

import detections
import numpy as np
import pytest

from mooringdx.plots import FIGURES, canvas, paint, save, statistic, suspects, whiteness
from mooringdx.types import Event, Grid, replace

CASES = [
    (case, name, part)
    for case, build in detections.ALL.items()
    for name, plot in FIGURES.items()
    for part in plot.parts(build())[:1]
]


@pytest.mark.parametrize(("case", "name", "part"), CASES)
def test_text_stays_inside_and_axes_have_units(case: str, name: str, part: str) -> None:
    """Truth: geometry. The tight box of all artists lies in the canvas; every labelled axis names a unit."""
    detection = detections.ALL[case]()
    figure = paint(FIGURES[name], detection, part)
    box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert box.x0 >= -0.01
    assert box.y0 >= -0.01
    assert box.x1 <= width + 0.01
    assert box.y1 <= height + 0.01
    for axes in figure.axes:
        assert "(" in axes.get_ylabel() or axes.get_label() == "<colorbar>"
        labelled = [a.get_xlabel() for a in axes.get_shared_x_axes().get_siblings(axes)]
        assert any("(" in label for label in labelled) or axes.get_label() == "<colorbar>"
    assert FIGURES[name].caption(detection, part).endswith(".")


def test_no_line_has_more_than_4000_vertices() -> None:
    """Truth: counted, on a record of 864,000 samples (a day at 10 Hz)."""
    detection = detections.line_lost(864_000)
    for name in ("channels", "statistic", "event"):
        plot = FIGURES[name]
        figure = paint(plot, detection, plot.parts(detection)[0])
        assert max(len(line.get_xdata()) for axes in figure.axes for line in axes.lines) <= 4000


def test_envelope_keeps_every_extreme() -> None:
    """Truth: brute force over the same bins."""
    rng = np.random.default_rng(1)
    y = rng.standard_normal(10_007)
    y[500:900] = np.nan
    y[7_777] = 40.0
    x, thin = canvas.envelope(np.arange(y.size, dtype=float), y, 100)
    edges = np.linspace(0, y.size, 101).astype(int)
    assert x.size == thin.size == 200
    for k in range(100):
        block = y[edges[k] : edges[k + 1]]
        block = block[np.isfinite(block)]
        pair = thin[2 * k : 2 * k + 2]
        assert np.isnan(pair).all() if block.size == 0 else tuple(pair) == (block.min(), block.max())


def test_short_lines_are_left_alone() -> None:
    x = np.arange(50.0)
    assert canvas.envelope(x, x)[1] is x


def test_holes_are_the_runs_of_false() -> None:
    valid = np.ones(1000, dtype=bool)
    valid[10:20] = valid[990:] = False
    assert canvas.holes(valid) == [(10, 20), (990, 1000)]
    assert canvas.holes(np.ones(5, dtype=bool)) == []


def test_autocorrelation_of_a_known_process() -> None:
    """Truth: brute force over valid pairs, and the AR(1) law rho_k = 0.8^k."""
    rng = np.random.default_rng(2)
    x = np.zeros(40_000)
    for i in range(1, x.size):
        x[i] = 0.8 * x[i - 1] + rng.standard_normal()
    x[1000:3000] = np.nan
    rho = whiteness.autocorrelation(x, 12)
    z = x - np.nanmean(x)
    brute = np.array([np.nanmean(z[: z.size - k] * z[k:]) for k in range(13)])
    np.testing.assert_allclose(rho, brute / brute[0], atol=1e-9)
    np.testing.assert_allclose(rho, 0.8 ** np.arange(13), atol=0.05)


def test_gaussian_plot_of_gaussian_data_is_straight() -> None:
    """Truth: analytic. Quantiles of N(2, 3) lie on 2 + 3 score."""
    x = 2.0 + 3.0 * np.random.default_rng(3).standard_normal(200_000)
    sample, score = whiteness.gaussian_plot(x)
    inner = np.abs(score) < 3
    np.testing.assert_allclose(sample[inner], 2.0 + 3.0 * score[inner], atol=0.15)
    assert np.all(np.diff(score) > 0)


def test_tail_is_the_chi_square_where_the_power_is_one() -> None:
    """Truth: analytic. With one degree, shape 1 and its own median, P(g > x) = erfc(sqrt(x)) for 2g chi-square."""
    from math import erfc, sqrt

    threshold = replace(detections.line_lost().thresholds[0], tail={"degrees": 1.0, "median": 0.2274682, "shape": 1.0})
    drawn = statistic.tail(threshold, np.array([0.5, 2.0, 9.0]))
    assert drawn is not None
    np.testing.assert_allclose(drawn[1], [erfc(sqrt(v)) for v in (0.5, 2.0, 9.0)], rtol=1e-5)
    assert statistic.tail(replace(threshold, tail={"inflation": 1.0}), np.ones(3)) is None


def test_the_lost_line_puts_its_own_residual_first() -> None:
    """Truth: construction. line_4 moves learned_tension_4 by far the most."""
    detection = detections.line_lost()
    assert suspects.residuals_of(detection, detection.events[0])[0] == "learned_tension_4"
    first, rest = suspects.residual_order(detection)
    assert detection.residuals is not None
    assert sorted(first + rest) == sorted(detection.residuals.names)


def test_an_event_names_its_branch() -> None:
    detection = detections.line_lost()
    event = replace(detection.events[0], evidence={"detector": "glrt (short, main branch)"})
    assert statistic.lead_branch(detection, event) == "short"
    assert statistic.lead_branch(detection, replace(event, evidence={})) == "main"


def test_clock_follows_span_and_epoch() -> None:
    assert canvas.clock(Grid(0.0, 0.1, 15_000)).label == "time (s, log clock)"
    assert canvas.clock(Grid(0.0, 0.1, 864_000)).label == "time (h, log clock)"
    dated = canvas.clock(Grid(0.0, 86400.0, 10, epoch_ns=0))
    assert dated.label == "date (UTC), 1970-01-01 to 1970-01-11"
    assert float(dated(86400.0)) == 1.0


def test_display_units() -> None:
    assert canvas.display("rad", np.ones(3)) == (pytest.approx(57.29578), "deg")
    assert canvas.display("N", np.full(3, 2e6)) == (1e-3, "kN")
    assert canvas.display("m", np.full(3, np.nan)) == (1.0, "m")


def test_many_events_do_not_break_a_figure() -> None:
    base = detections.line_lost()
    crowd = tuple(Event("unknown", "log", t, (t, t), t) for t in np.linspace(1000.0, 1500.0, 40))
    detection = replace(base, events=crowd)
    paint(FIGURES["channels"], detection, "1")
    assert len(FIGURES["event"].parts(detection)) == 6


def test_bytes_are_the_same_twice_and_carry_the_source() -> None:
    detection = detections.adrift()
    once, twice = (save(paint(FIGURES["track"], detection), {"Source": "sha 12"}) for _ in range(2))
    assert once == twice
    assert b"sha 12" in once[0]
    assert b"sha 12" in once[1]


def test_no_pyplot() -> None:
    """Truth: the interpreter's own list of modules."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import detections; from mooringdx.plots import *;"
        "paint(FIGURES['track'], detections.adrift()); assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code, str(detections.__file__).rsplit("/", 1)[0]], check=True)
