"""The reproduction of [PositionThesis, chapter 5]: tables of delays and of half a day, sentences judged, and figures.

configs/scenarios/thesis_none.toml is the vessel in its sea; `mooringdx.reproduce.position_cases` makes the eight cases
and the benches of it.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mooringdx import __version__
from mooringdx.errors import ReportError
from mooringdx.hypotheses.thesis_bank import ThesisBank
from mooringdx.page import render
from mooringdx.physics.rig import mooring_of
from mooringdx.plots import save
from mooringdx.reproduce.effects import FAILS, HOLDS, PARTLY, Claim
from mooringdx.reproduce.fang2015 import setting
from mooringdx.reproduce.position_cases import BENCHES, CASES, said, scenario, trial
from mooringdx.reproduce.position_claims import Beyond, beyond_claims, delay_cells
from mooringdx.reproduce.position_days import WATERS, night_cells, night_record, nights
from mooringdx.reproduce.position_drawing import DPI, SHEETS, Shown, captions, paint, painted
from mooringdx.reproduce.position_ours import NAMES, ours_cell, ours_record, ours_table
from mooringdx.reproduce.position_ours_drawing import OUR_SHEETS, looked, our_captions
from mooringdx.reproduce.position_table import METHODS, RECORDS, Row, cell, claims, record_of, table
from mooringdx.results import json_bytes, write_files
from mooringdx.simulate.scenario import Scenario, load_scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


def reproduce(out: Path, seed: int, repeats: int = 1) -> str:
    """Write the whole reproduction into ``out``; see the module. Return the claims in words, a line each.

    ``repeats``: how many times as many records, of the cases and of half a day, as by default.
    """
    _refuse_strangers(out)
    path = setting("scenarios", "thesis_none")
    base = load_scenario(path)
    rows, banks = table(base, seed, repeats * RECORDS)
    ours, own = ours_table(base, seed, repeats * RECORDS)
    seen = tuple(looked(base, case, bank, seed) for case, bank in zip(CASES, own, strict=True))
    beyond = Beyond(ours, nights(base, banks, seed, repeats), seen)
    found = (*claims(rows), *beyond_claims(rows, beyond))
    made = pages(base, rows, banks[BENCHES[0].name], found, seed, beyond)
    write_files(out, made)
    for old in sorted((out / "figures").glob("*")):
        if f"figures/{old.name}" not in made:
            old.unlink()
    return text(rows, found, beyond)


def command(seed: int) -> str:
    """Return the command that makes the page again."""
    return f"mooringdx reproduce {NAME} -o DIR --seed {seed}"


def pages(
    base: Scenario,
    rows: Sequence[Row],
    bank: ThesisBank,
    found: Sequence[Claim],
    seed: int,
    beyond: Beyond | None = None,
) -> dict[str, bytes]:
    """Return {relative name: bytes}: index.html, claims.json, and every figure as PNG and SVG."""
    out, shown = {}, []
    for name, title, caption, figure in _figures(base, bank, seed, beyond):
        png, svg = save(figure, {"Title": title, "Description": caption, "Source": command(seed)}, DPI)
        out[f"figures/{name}.png"], out[f"figures/{name}.svg"] = png, svg
        uri = "data:image/png;base64," + base64.b64encode(png).decode()
        shown.append({"name": name, "title": title, "caption": caption, "uri": uri})
    body = {
        "format": "mooringdx claims 1",
        "paper": "PositionThesis",
        "command": command(seed),
        "mooringdx": __version__,
        "claims": list(found),
        "table": [record_of(row) for row in rows],
        "ours": [ours_record(row) for row in beyond.ours] if beyond else [],
        "half_a_day": [night_record(night) for night in beyond.nights] if beyond else [],
        "misprints": [dict(zip(("where", "printed", "meant"), row, strict=True)) for row in MISPRINTS],
    }
    context = {
        "found": found,
        "records": len(rows[0].scores["dht"]),
        "benches": [*(bench.name for bench in BENCHES), *(NAMES[:1] if beyond else ())],
        "methods": list(zip(METHODS, ("Dynamic hypothesis testing", "Maximum likelihood"), strict=True)),
        "table": {method: _cells(rows, method, beyond) for method in METHODS},
        "delays": delay_cells(rows),
        "ours_names": NAMES,
        "ours": _our_cells(beyond),
        "waters": [water.name for water in WATERS],
        "nights": night_cells(beyond.nights) if beyond else [],
        "shown": shown,
        "misprints": MISPRINTS,
        "facts": _facts(base, seed),
    }
    return {"index.html": render("position_thesis.html.j2", context).encode(), "claims.json": json_bytes(body), **out}


def _figures(
    base: Scenario, bank: ThesisBank, seed: int, beyond: Beyond | None
) -> Iterator[tuple[str, str, str, Figure]]:
    """Give name, title, caption and figure of each, the thesis's bank first."""
    told = captions(command(seed))
    for name, sheet in SHEETS.items():
        case = CASES[sheet.case]
        record = trial(scenario(base, case), (seed, 0), BENCHES[0].shared)
        yield name, sheet.title, told[name], paint(sheet, Shown(case, record, bank, said(bank, record)))
    if beyond is None:
        return
    told = our_captions(command(seed))
    for name, own in OUR_SHEETS.items():
        yield name, own.title, told[name], painted(partial(own.draw, beyond.seen), own.seen)


def _facts(base: Scenario, seed: int) -> list[tuple[str, str]]:
    """Return what made the page, and the current's force and speed in each case."""
    pull = float(mooring_of(base.typed()).pulls(np.zeros(3))[0][-1])
    speeds = {case.pull: scenario(base, case).current.speed for case in CASES if case.pull}
    forces = "; ".join(
        f"{share} of {pull / 1e3:.0f} kN = {share * pull / 1e3:.0f} kN ({speed:.2f} m/s on this hull's beam) "
        + ("where line 8 is lost" if share == CASES[-1].pull else "elsewhere")
        for share, speed in speeds.items()
    )
    return [("Command", command(seed)), ("Vessel", base.vessel), ("Current", forces), ("mooringdx", __version__)]


def text(rows: Sequence[Row], found: Sequence[Claim], beyond: Beyond | None = None) -> str:
    """Return tables and claims for a terminal."""
    count = {verdict: sum(c.verdict == verdict for c in found) for verdict in (HOLDS, PARTLY, FAILS)}
    head = f"PositionThesis, {len(found)} claims: " + ", ".join(f"{n} {verdict}" for verdict, n in count.items() if n)
    lines = [head, *(f"  {c.verdict:16s}{c.where:16s}{c.paper}" for c in found)]
    for method in METHODS:
        lines.append(f"{method.upper()}, the thesis | " + " | ".join(bench.name for bench in BENCHES))
        lines += [f"  {row[0]:17s} {' | '.join(row[1:])}" for row in _cells(rows, method)]
    if beyond is not None:
        lines.append(" | ".join(NAMES))
        lines += [f"  {row[0]:17s} {' | '.join(row[1:])}" for row in _our_cells(beyond)]
        lines.append("half a day, nothing lost | " + " | ".join(water.name for water in WATERS))
        lines += [f"  {' | '.join(row)}" for row in night_cells(beyond.nights)]
    return "\n".join(lines)


def _cells(rows: Sequence[Row], method: str, beyond: Beyond | None = None) -> list[list[str]]:
    """Return a line a case: its name, the thesis's figure, every bench's, and our default's where it is at hand."""
    out = []
    for case in CASES:
        own = [row for row in rows if row.case is case]
        line = [case.name, case.thesis[METHODS.index(method)], *(cell(row, method) for row in own)]
        ours = [ours_cell(row) for row in beyond.ours if row.case is case and row.name == NAMES[0]] if beyond else []
        out.append([*line, *ours])
    return out


def _our_cells(beyond: Beyond | None) -> list[list[str]]:
    """Return a line a case: its name, and what our default said, with and without the current learned."""
    ours = beyond.ours if beyond else ()
    return [[case.name, *(ours_cell(row) for row in ours if row.case is case)] for case in CASES] if ours else []


def _refuse_strangers(out: Path) -> None:
    if out.is_file():
        raise ReportError(f"{out}: is a file, not a folder; give another -o DIR")
    for item in sorted(out.iterdir()) if out.exists() else []:
        if item.name not in OWN and not item.name.startswith("."):
            raise ReportError(f"{out}: holds '{item.name}', which reproduce did not write; give another -o DIR")
