"""The page of a reproduction: claims and figures in one self-contained HTML file, and the same numbers as JSON."""

from __future__ import annotations

import base64
from collections.abc import Sequence

from mooringdx import __version__
from mooringdx.page import render
from mooringdx.plots import save
from mooringdx.reproduce.drawing import DPI, SHEETS, captions, paint
from mooringdx.reproduce.effects import Claim
from mooringdx.reproduce.study import Study
from mooringdx.results import json_bytes

MISPRINTS: tuple[tuple[str, str, str], ...] = (
    (
        "5.1",
        "peak period 0.15 s at model scale",
        "1.5 s (9.1 s full scale): at 0.15 s a wave is 0.035 m long, shorter than Hs = 0.06 m is high",
    ),
    (
        "Figs. 3-8",
        "residual of line 4 called r5",
        "r9 by eq. 6, which numbers the residual of line j as r(5+j); the figures here keep the paper's r5",
    ),
    ("Fig. 8, 3.2", "window of 400 samples in the figure, 150 in the text", "a setting; both are drawn"),
    (
        "Figs. 3-8, 13, 14",
        "buoy lost at 580 s in one, fault at 700 s in the other",
        "two experiments; this is the first",
    ),
    (
        "eq. 4",
        "a current subtracted from a position; acceleration in earth axes",
        "the current subtracted from the speed; everything in body axes",
    ),
    (
        "eq. 7",
        'F and C without leading 1, C with a_2, "Hurwitz"',
        "F = 1 + sum a_i q^-i, C = 1 + sum c_i q^-i, the roots of C inside the unit circle",
    ),
    (
        "eqs. 9, 10",
        "the knee is a multiple of the sd of what it makes",
        "a fixed point: there is one for k > 1, and only one",
    ),
    (
        "p. 7 and p. 9",
        "whitened then compressed; compressed then whitened",
        "whitened then compressed, as in the figures; the other is measured beside it",
    ),
    ("L_G", "a sum of likelihood ratios", "their product"),
    ("eqs. 13, 16", "mu0 outside the sum", "inside: the mean of z - mu0"),
    (
        "eqs. 14, 15",
        "factor M/2 missing, M + 1 terms",
        "g = (M/2)(...)^2/(...), M terms; then 2 g is chi-square for white z",
    ),
    ("eq. 18", "argmax of an unnormalised, signed projection", "(...)^2/(G' Q^-1 G), whose argmax is that of g"),
    ("eq. 19", "max, and one level for all lines", "argmax of g over its own level"),
    ("eqs. 20-22", "P is a probability a sample", "P = D Ts/(n T) for one alarm in T on n lines, D the cluster length"),
)
"""Where in the paper, what is printed, how it was read."""


def pages(study: Study, found: Sequence[Claim], command: str) -> dict[str, bytes]:
    """Return {relative name: bytes}: index.html, claims.json, and every figure as PNG and SVG."""
    source = f"log sha256 {study.detection.channels.source.sha256}; {command}"
    out: dict[str, bytes] = {}
    shown = []
    told = captions(study, command)
    for name, sheet in SHEETS.items():
        caption = told[name]
        meta = {"Title": f"Fang2015: {sheet.title}", "Description": caption, "Source": source}
        png, svg = save(paint(sheet, study), meta, DPI)
        out[f"figures/{name}.png"], out[f"figures/{name}.svg"] = png, svg
        uri = "data:image/png;base64," + base64.b64encode(png).decode()
        shown.append({"name": name, "title": sheet.title, "caption": caption, "uri": uri})
    body = {
        "format": "mooringdx claims 1",
        "paper": "Fang2015",
        "command": command,
        "mooringdx": __version__,
        "log_sha256": study.detection.channels.source.sha256,
        "claims": list(found),
        "misprints": [dict(zip(("where", "printed", "meant"), row, strict=True)) for row in MISPRINTS],
    }
    page = render(
        "reproduce.html.j2",
        {"study": study, "found": found, "shown": shown, "misprints": MISPRINTS, "facts": facts(study, command)},
    )
    return {"index.html": page.encode(), "claims.json": json_bytes(body), **out}


def facts(study: Study, command: str) -> list[tuple[str, str]]:
    """Return what ties the page to its input."""
    channels, start = study.detection.channels, study.window
    grid = channels.grid
    return [
        ("Command", command),
        ("Record", f"simulated; {grid.start:g} to {grid.stop:g} s, {grid.n:,} samples each {grid.sample_time:g} s"),
        ("No-fault window", f"{start[0]:g} to {start[1]:g} s"),
        ("Fault", f"the buoyancy element of {study.line.replace('_', ' ')}, at {study.onset:g} s"),
        (
            "Residuals",
            f"r1 is {study.force.name} ({study.force.unit}), r5 is {study.tension.name} ({study.tension.unit})",
        ),
        ("sha256 of the log", channels.source.sha256),
        ("Configuration digest", study.baseline.config().digest()),
        ("mooringdx", __version__),
    ]
