"""Write a commented starter run file from what `survey` found: every guess says that it is one, and why."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mooringdx.channels import entry
from mooringdx.logs.survey import SurveyRow

ROUND = (1.0, 2.0, 2.5, 4.0, 5.0, 8.0)
SLOW = 3600.0
FAST = 0.05
NO_FAULT_SHARE = 0.6
MOTIONS = ("surge", "sway", "heave", "roll", "pitch", "yaw", "heading", "north", "east", "down")


@dataclass(frozen=True)
class Choice:
    """One line of [channels]: catalogue name, where it stands, why; ``used`` is False where it is only a comment."""

    name: str
    row: SurveyRow
    reason: str
    used: bool


def guess(rows: Sequence[SurveyRow]) -> Mapping[str, Choice]:
    """Return the mapping that a starter run file proposes: catalogue name -> choice, unused ones included.

    Used are the signals with a catalogue name that have numbers and change; latitude and longitude only where north and
    east are not logged.
    """
    known = {r.guess for r in rows if r.known and r.samples > r.nonfinite}
    local = {"north", "east"} <= known
    choices: dict[str, Choice] = {}
    for row in rows:
        used, why = row.known, row.reason
        if row.clock:
            used = False
        elif row.samples == row.nonfinite:
            used, why = False, "no number in it"
        elif row.known and row.min == row.max:
            used, why = False, f"{row.reason}, but it never changes"
        elif row.guess in ("latitude", "longitude") and local:
            used, why = False, f"{row.reason}, but north and east are logged"
        choices[row.guess] = Choice(row.guess, row, why, used)
    return choices


def starter(
    path: Path,
    rows: Sequence[SurveyRow],
    vessel: str | None = None,
    lines: Sequence[str] = (),
    out: Path | None = None,
) -> str:
    """Return a commented run file (TOML) for the log at ``path`` that `load_run` accepts as it stands.

    Parameters
    ----------
    path : of the log. rows : from `survey`.
    vessel, lines : the vessel that the run file is to name, and its lines; None makes a model-free run.
    out : where the run file will stand; the log's path is written relative to it.
    """
    choices = guess(rows)
    used = {name: c for name, c in choices.items() if c.used}
    if not used:
        choices = {n: Choice(n, c.row, c.reason, c.row.samples > c.row.nonfinite) for n, c in choices.items()}
        used = {name: c for name, c in choices.items() if c.used}
    periods = [1.0 / c.row.rate for c in used.values() if c.row.rate]
    slow = bool(periods) and min(periods) >= SLOW and any(n in used for n in ("north", "latitude"))
    if slow:
        task = [_bank()]
    elif vessel is not None and _position_alone(used):
        task = [_baseline(used), _onset()]
    else:
        task = [_residuals(used, vessel is not None), _baseline(used), _rest()]
    parts = [
        _log(path, rows, out),
        _channels(choices),
        _clock(used, periods),
        _mooring(used) if vessel is None else _vessel(used, vessel, lines),
        *task,
    ]
    return "\n\n".join(parts) + "\n"


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)


def _number(value: float) -> str:
    return repr(float(f"{value:.6g}"))


def _log(path: Path, rows: Sequence[SurveyRow], out: Path | None) -> str:
    where = path.resolve() if out is None else Path(os.path.relpath(path.resolve(), out.resolve().parent))
    time = '# time: the clock of each message (log_time); or time = { source = "header" }, "publish_time"'
    if not any(r.topic for r in rows):
        time = (
            "# time is found by itself; name it where that is wrong, for example\n"
            '# time = { column = "time", unit = "s" }     # or "ms", "min", "h", "iso8601", "epoch_s", "epoch_ms"'
        )
    return f"""# A starter for {path.name}, guessed from its names, units and rates. Check every line marked "guess".

[log]
path = {_text(where.as_posix())}
{time}"""


def _channels(choices: Mapping[str, Choice]) -> str:
    lines = ["[channels]   # catalogue name = where it stands in the log, and its unit there"]
    for name, c in choices.items():
        place = _place(c.row)
        unit = f", unit = {_text(c.row.unit)}" if c.row.unit else ""
        if unit or name.startswith("x_"):
            stated = ""
        else:
            stated = f"; no unit stated, taken as {entry(name).assumed or entry(name).unit}: check"
        mark = "" if c.used else "# "
        lines.append(f"{mark}{name} = {{ {place}{unit} }}   # guess: {c.reason}{stated}")
    return "\n".join(lines)


def _place(row: SurveyRow) -> str:
    if row.topic:
        return f"topic = {_text(row.topic)}, field = {_text(row.field)}"
    return f"column = {_text(row.source)}"


def _clock(used: Mapping[str, Choice], periods: Sequence[float]) -> str:
    wanted = [1.0 / c.row.rate for n, c in used.items() if c.row.rate and (n in MOTIONS or n.startswith("tension_"))]
    step = _nice(max(wanted or periods or [1.0]))
    gap = max(1.0, *(1.5 * p for p in periods), 3.0 * step) if periods else 1.0
    if step >= SLOW:
        gap = 1.5 * step
    rates = ", ".join(sorted({f"{c.row.rate:.4g}" for c in used.values() if c.row.rate}))
    return f"""[clock]
# guess from the logged rates ({rates or "unknown"} Hz); a fifteenth of the waves' peak period is enough
sample_time = {_number(step)}   # s
max_gap = {_number(gap)}   # s; longer gaps are masked, never filled
# zero = {{ channels = ["..."], window = [0.0, 15.0] }}   # subtract each log's own median over a calm stretch
# groups = {{ camera = ["sway", "heave", "roll"] }}   # one instrument: its channels freeze, and run late, together
# spike_sd = 12.0     # an isolated excursion of up to three samples above this many robust sd is left out
# stuck_after = 1.0   # s; a hold beyond this while the others move is an event"""


def _nice(period: float) -> float:
    """Return a sample time at or just above a period: the round number it is, or three digits; at least 0.05 s."""
    if period < FAST:
        return FAST
    power = 10.0 ** math.floor(math.log10(period))
    for step in (*(r * power for r in (*ROUND, 10.0)), 60.0, 600.0, 1800.0, 3600.0, 10800.0, 21600.0, 86400.0):
        if abs(period / step - 1.0) < 0.01:
            return step
    return float(f"{period:.3g}")


def _vessel(used: Mapping[str, Choice], vessel: str, lines: Sequence[str]) -> str:
    seen = {f"line_{n.removeprefix('tension_')}" for n in used if n.startswith("tension_")}
    missing = [line for line in lines if line not in seen]
    known = [line for line in lines if line in seen]
    text = f"""[mooring]
vessel = {_text(vessel)}   # a file in configs/vessels, or a path relative to this file
lines = {json.dumps(known)}   # its lines with a tension in the log
# origin = [0.0, 0.0]   # m: where the neutral place of its turret stands in the log's north and east: check"""
    if missing:
        text += f"\n# no tension of {', '.join(missing)} was found; name its channel above: tension_... = {{ ... }}"
    return text


def _mooring(used: Mapping[str, Choice]) -> str:
    lines = [f"line_{n.removeprefix('tension_')}" for n in used if n.startswith("tension_")]
    text = '[mooring]\n# vessel = "..."   # a file in configs/vessels, or a path: residuals then know its lines\n'
    if lines:
        text += f"lines = {json.dumps(lines, ensure_ascii=False)}   # guess: one line a tension"
    else:
        text += '# lines = ["line_1"]   # default: one line for every channel tension_<line>'
    example = lines[0] if lines else "line_1"
    return (
        text
        + f"\n# azimuth = {{ {example} = 30.0 }}   # deg true from the vessel to each anchor; learned when left out"
    )


def _position_alone(used: Mapping[str, Choice]) -> bool:
    """Tell whether a log has place and heading and no tension."""
    return _placed(used) and "heading" in used and not any(n.startswith("tension_") for n in used)


def _placed(used: Mapping[str, Choice]) -> bool:
    return {"north", "east"} <= set(used) or {"latitude", "longitude"} <= set(used)


def _residuals(used: Mapping[str, Choice], known: bool) -> str:
    if known:
        return """[residuals]
use = ["tension", "force_balance"]   # measured tension less the statics at the measured place; forces on the vessel"""
    kinds = ["learned"]
    if _placed(used):
        kinds.append("position")
    return f"""[residuals]
use = {json.dumps(kinds)}   # learned: each channel predicted from the others; position: offset from the neutral place
# add "position" once north and east are named
# parity = {{ r1 = "tension_SB + tension_PS" }}   # with use = ["parity"]: a relation you know beats one that is learned

# [residuals.learned]
# channels = []   # default: all that can be predicted
# lags = 0        # earlier samples of the others, taken in too"""


def _baseline(used: Mapping[str, Choice]) -> str:
    starts = [c.row.start for c in used.values() if c.row.start is not None]
    stops = [c.row.stop for c in used.values() if c.row.stop is not None]
    start, stop = (max(starts), min(stops)) if starts and stops else (0.0, 1.0)
    if stop <= start:
        start, stop = (min(starts), max(stops)) if starts and max(stops) > min(starts) else (0.0, 1.0)
    end = start + NO_FAULT_SHARE * (stop - start)
    return f"""[baseline]
# GUESS, CHECK IT: the first 60 % of the log. Nothing may have been broken in this window, and it must not hold still.
window = [{_number(start)}, {_number(end)}]   # s, half open"""


def _rest() -> str:
    return """# Defaults from here on.
# [whitening]
# order = "auto"   # none, ARMA or ARMA + compression, whichever finds the smallest fault; or "none", "bic", [6, 4]

# [detector]
# kind = "glrt"
# window = "auto"  # s; ten peak periods

[alarm]
rate = "1/month"   # false alarms asked for, all lines together, on the log's own clock
# assurance = 0.9  # the asked rate holds with this confidence"""


def _bank() -> str:
    return """# One position an hour or slower: judged by whether the mooring holds (see the README on adrift or moved).
[bank]
use = ["adrift"]"""


def _onset() -> str:
    return """# No tension was recognised: a lost line is sought from position, heading and thrust (docs/position.md).
# Map thrust_* and wind_* where they are logged; the no-fault window should hold about an hour at full scale.
[bank]
use = ["onset_glr"]

# Once tensions are named in [channels]:
# [residuals]
# use = ["tension", "force_balance"]"""
