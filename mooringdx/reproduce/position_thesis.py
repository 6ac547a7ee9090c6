"""The reproduction of [PositionThesis, chapter 5]: the table of delays, its sentences judged, and six figures.

configs/scenarios/thesis_none.toml is the vessel in its sea; `mooringdx.reproduce.position_cases` makes the eight cases
and the benches of it.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

from mooringdx import __version__
from mooringdx.errors import ReportError
from mooringdx.hypotheses.thesis_bank import ThesisBank
from mooringdx.page import render
from mooringdx.plots import save
from mooringdx.reproduce.effects import FAILS, HOLDS, PARTLY, Claim
from mooringdx.reproduce.fang2015 import setting
from mooringdx.reproduce.position_cases import BENCHES, CASES, said, scenario, trial
from mooringdx.reproduce.position_drawing import DPI, SHEETS, Shown, captions, paint
from mooringdx.reproduce.position_table import METHODS, Row, cell, claims, record_of, table
from mooringdx.results import json_bytes, write_files
from mooringdx.simulate.scenario import Scenario, load_scenario

NAME = "position-thesis"
OWN = ("index.html", "figures", "claims.json")
MISPRINTS: tuple[tuple[str, str, str], ...] = (
    ("eqs. 3.7, 3.10, 3.11", "w0^2 and 2 z w0 with plus signs", "minus; as printed the wave model runs away"),
    (
        "listing A.4",
        "zeta_n = 1 in the wave model's damping",
        "kept in the printed bank, lambda = 0.1 in the mended one",
    ),
    (
        "eq. 3.16, row 3",
        "lever arm from the distance to the anchor, zero identically",
        "from the fairlead; zero here too",
    ),
    ("eq. 3.19d", "no mooring force", "that of eq. 3.17, as the text of 4.6.4 says"),
    (
        "eqs. 4.7, 4.8",
        "K3, K4 of 0.1 N/m and less on 1e8 kg",
        "kept in the printed bank: its bias is zero for all that is seen; times the mass in the mended one",
    ),
    ("eqs. 3.21-3.24", "union of sets; an integral dt", "Bayes' rule over nine hypotheses"),
    ("eqs. 3.32-4.10", "S' in the exponent", "the inverse of S"),
    ("eq. 4.10", "a factor on the sum so far", "recursive, as the listing runs: a memory of 100 s"),
    (
        "A.1, A.2",
        "S = cov(y~) + R: the noise counted twice",
        "kept in the printed bank, S = E y~ y~' in the mended one",
    ),
    ("4.4", "cov(), which takes the mean off", "kept; the second moment about zero in the mended bank"),
    ("text; listing", "floor 1e-9, c 0.999, K4 0.1; 1e-12, 0.99, 0.3", "the text's; the listing's are a setting"),
    ("A.4", "damping at 0.88 rad/s, added mass at infinity", "kept; at zero frequency in the mended bank"),
    ("4.3", "heading gain of 1000 N m/rad", "a heading loop of 0.05 rad/s: the printed one cannot hold a heading"),
)
"""Where in the thesis, what is printed, how it was read."""


def reproduce(out: Path, seed: int) -> str:
    """Write the whole reproduction into ``out``; see the module. Return the claims in words, a line each."""
    _refuse_strangers(out)
    path = setting("scenarios", "thesis_none")
    base = load_scenario(path)
    rows, banks = table(base, seed)
    found = claims(rows)
    made = pages(base, rows, banks[BENCHES[0].name], found, seed)
    write_files(out, made)
    for old in sorted((out / "figures").glob("*")):
        if f"figures/{old.name}" not in made:
            old.unlink()
    return text(rows, found)


def command(seed: int) -> str:
    """Return the command that makes the page again."""
    return f"mooringdx reproduce {NAME} -o DIR --seed {seed}"


def pages(base: Scenario, rows: Sequence[Row], bank: ThesisBank, found: Sequence[Claim], seed: int) -> dict[str, bytes]:
    """Return {relative name: bytes}: index.html, claims.json, and every figure as PNG and SVG."""
    told, out, shown = captions(command(seed)), {}, []
    for name, sheet in SHEETS.items():
        case = CASES[sheet.case]
        record = trial(scenario(base, case), (seed, 0), BENCHES[0].shared)
        figure = paint(sheet, Shown(case, record, bank, said(bank, record)))
        png, svg = save(figure, {"Title": sheet.title, "Description": told[name], "Source": command(seed)}, DPI)
        out[f"figures/{name}.png"], out[f"figures/{name}.svg"] = png, svg
        uri = "data:image/png;base64," + base64.b64encode(png).decode()
        shown.append({"name": name, "title": sheet.title, "caption": told[name], "uri": uri})
    body = {
        "format": "mooringdx claims 1",
        "paper": "PositionThesis",
        "command": command(seed),
        "mooringdx": __version__,
        "claims": list(found),
        "table": [record_of(row) for row in rows],
        "misprints": [dict(zip(("where", "printed", "meant"), row, strict=True)) for row in MISPRINTS],
    }
    context = {
        "found": found,
        "records": len(rows[0].scores["dht"]),
        "benches": [bench.name for bench in BENCHES],
        "methods": list(zip(METHODS, ("Dynamic hypothesis testing", "Maximum likelihood"), strict=True)),
        "table": {method: _cells(rows, method) for method in METHODS},
        "shown": shown,
        "misprints": MISPRINTS,
        "facts": [("Command", command(seed)), ("Vessel", base.vessel), ("mooringdx", __version__)],
    }
    return {"index.html": render("position_thesis.html.j2", context).encode(), "claims.json": json_bytes(body), **out}


def text(rows: Sequence[Row], found: Sequence[Claim]) -> str:
    """Return table and claims for a terminal."""
    count = {verdict: sum(c.verdict == verdict for c in found) for verdict in (HOLDS, PARTLY, FAILS)}
    head = f"PositionThesis, {len(found)} claims: " + ", ".join(f"{n} {verdict}" for verdict, n in count.items() if n)
    lines = [head, *(f"  {c.verdict:16s}{c.where:8s}{c.paper}" for c in found)]
    for method in METHODS:
        lines.append(f"{method.upper()}, the thesis | " + " | ".join(bench.name for bench in BENCHES))
        lines += [f"  {row[0]:17s} {' | '.join(row[1:])}" for row in _cells(rows, method)]
    return "\n".join(lines)


def _cells(rows: Sequence[Row], method: str) -> list[list[str]]:
    """Return a line a case: its name, the thesis's figure, and every bench's."""
    out = []
    for case in CASES:
        own = [row for row in rows if row.case is case]
        out.append([case.name, case.thesis[METHODS.index(method)], *(cell(row, method) for row in own)])
    return out


def _refuse_strangers(out: Path) -> None:
    if out.is_file():
        raise ReportError(f"{out}: is a file, not a folder; give another -o DIR")
    for item in sorted(out.iterdir()) if out.exists() else []:
        if item.name not in OWN and not item.name.startswith("."):
            raise ReportError(f"{out}: holds '{item.name}', which reproduce did not write; give another -o DIR")
