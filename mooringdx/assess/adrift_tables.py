"""The numbers of an adrift-or-moved assessment, as text, Markdown and JSON-safe values; nothing is computed twice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mooringdx import __version__
from mooringdx.assess.adrift import COLUMNS, LOST, ROWS, Row, Score, other_rate
from mooringdx.assess.intervals import binomial
from mooringdx.config import RunConfig
from mooringdx.hypotheses.adrift import CALLS

CAVEAT = (
    "The labels are kinematic: a rule made them from these same tracks, and no list of break-aways was published with "
    "the data. Every figure here flatters rules that look at the track. A buoy aboard a ship cannot be excluded for "
    "any one event, and a mooring that parted while the buoy stayed in its circle is in no label and in no answer."
)
LABEL_COLUMNS: tuple[str, ...] = (
    "site", "first day outside", "label", "called", "warned", "not holding", "moved", "held",
    "P(not holding) day 2", "plain", "circle",
)  # fmt: skip
MATCHING = (
    "A warning answers a label when it is open between the last day inside and the end of the drift (five days after "
    "the first day outside where the label gives no end). Delays are whole days from the first day outside, causal. "
    "Rates are per buoy-year of fixes. [a, b] is the exact 95 % interval (binomial or Poisson)."
)


def numbers(scores: Sequence[Score]) -> dict[str, Any]:
    """Return every figure of one or several sites taken together."""
    rows = [row for score in scores for row in score.rows]
    years = sum(score.track.years for score in scores)
    adrift, drag, moved = ([r for r in rows if r.label.kind == kind] for kind in ROWS)
    lost = adrift + drag
    total = {k: sum(len(getattr(s, k)) for s in scores) for k in ("other_warnings", "other_alarms")}
    return {
        "sites": [s.track.site.name for s in scores],
        "buoy_years": years,
        "not_scored_ambiguous": sum(len(s.ambiguous) for s in scores),
        "confusion": {name: _confusion([r for r in rows if r.label.kind == kind]) for kind, name in ROWS.items()},
        "warning_by_day_1": _share(sum(_within(r.warned, 1) for r in adrift), len(adrift)),
        "not_holding_adrift": _share(sum(r.not_holding is not None for r in adrift), len(adrift)),
        "not_holding_days": _delays([r.not_holding for r in adrift]),
        "not_holding_dragged": _share(sum(r.not_holding is not None for r in drag), len(drag)),
        "dragged_later_held": _share(sum(r.held_after is not None for r in drag), len(drag)),
        "redeployed_called_lost": _share(sum(r.called == LOST for r in moved), len(moved)),
        "redeployed_moved_by_day_3": _share(sum(_within(r.moved, 3) for r in moved), len(moved)),
        "other_warnings": other_rate(total["other_warnings"], years),
        "other_alarms": other_rate(total["other_alarms"], years),
        "brier_day_2": {"value": _brier(rows), "n": len(rows), "interval": _brier_interval(rows)},
        "plain_rule": _peer(adrift, drag, moved, "plain", sum(s.other_plain for s in scores), years),
        "fixed_circle": _peer(adrift, drag, moved, "circle", sum(s.other_circle for s in scores), years),
        "lost_labels": len(lost),
    }


def _within(delay: int | None, days: int) -> bool:
    return delay is not None and delay <= days


def _share(count: int, n: int) -> dict[str, Any]:
    low, high = binomial(count, n)
    return {"count": count, "n": n, "low": low, "high": high}


def _confusion(rows: Sequence[Row]) -> dict[str, Any]:
    return {column: _share(sum(r.called == column for r in rows), len(rows)) for column in COLUMNS}


def _delays(delays: Sequence[int | None]) -> dict[str, Any]:
    """Return the delays; a miss counts as infinite in the median."""
    known = np.array([np.inf if d is None else d for d in delays])
    median = float(np.median(known)) if known.size else None
    return {"each": list(delays), "median": median, "worst": float(known.max()) if known.size else None}


def _brier(rows: Sequence[Row]) -> float:
    return float(np.mean([(r.day_2 - r.label.lost) ** 2 for r in rows])) if rows else float("nan")


def _brier_interval(rows: Sequence[Row]) -> tuple[float, float]:
    """Return the 95 % interval by 2000 seeded resamples of the labels."""
    if not rows:
        return float("nan"), float("nan")
    errors = np.array([(r.day_2 - r.label.lost) ** 2 for r in rows])
    draws = np.random.default_rng(20).integers(0, errors.size, (2000, errors.size))
    low, high = np.quantile(errors[draws].mean(axis=1), [0.025, 0.975])
    return float(low), float(high)


def _peer(
    adrift: Sequence[Row], drag: Sequence[Row], moved: Sequence[Row], name: str, other: int, years: float
) -> dict[str, Any]:
    def hits(rows: Sequence[Row]) -> dict[str, Any]:
        return _share(sum(getattr(r, name) is not None for r in rows), len(rows))

    return {
        "adrift": hits(adrift),
        "dragged": hits(drag),
        "redeployed": hits(moved),
        "days": _delays([getattr(r, name) for r in adrift]),
        "other_alarms": other_rate(other, years),
    }


def text(scores: Sequence[Score]) -> str:
    """Return the tables for the terminal."""
    parts = ["Adrift or moved: one position a day, scored against labelled tracks", "", CAVEAT, "", MATCHING, ""]
    for score in scores:
        role = (
            "settings were chosen on this site" if score.track.site.tuned_on else "settings frozen before it was scored"
        )
        parts += [_block(f"{score.track.site.name} ({role})", numbers([score]))]
    if len(scores) > 1:
        parts += [_block("all sites together (the site that was tuned on included)", numbers(scores))]
    return "\n".join([*parts, *_labels(scores), *_alarms(scores)])


def _block(title: str, n: dict[str, Any]) -> str:
    table = [("truth", "n", *COLUMNS, "plain rule: lost", "8 km circle: lost")]
    peers = {"adrift": "adrift", "dragged, then held": "dragged"}
    for name, row in n["confusion"].items():
        peer = peers.get(name, "redeployed")
        cells = [_cell(row[c]) for c in COLUMNS]
        table.append((name, str(row[LOST]["n"]), *cells, *(_cell(n[p][peer]) for p in ("plain_rule", "fixed_circle"))))
    other = [_rate(n[p]["other_alarms"]) for p in ("plain_rule", "fixed_circle")]
    plain, circle = n["plain_rule"]["days"], n["fixed_circle"]["days"]
    lines = [
        f"warning by day 1, adrift                {_cell(n['warning_by_day_1'])}",
        f"other warnings                          {_rate(n['other_warnings'])}",
        f"not holding, adrift                     {_cell(n['not_holding_adrift'])}; {_days(n['not_holding_days'])}",
        f"not holding, dragged; later held        {_cell(n['not_holding_dragged'])}; {_cell(n['dragged_later_held'])}",
        f"redeployed, called lost                 {_cell(n['redeployed_called_lost'])}",
        f"redeployed, called moved by day 3       {_cell(n['redeployed_moved_by_day_3'])}",
        f"other failure alarms                    {_rate(n['other_alarms'])}",
        f"Brier score of P(not holding) on day 2  {_brier_text(n['brier_day_2'])}",
        f"plain rule, adrift                      {_days(plain)}; other alarms {other[0]}",
        f"8 km circle, adrift                     {_days(circle)}; other alarms {other[1]}",
    ]
    head = f"{title}: {n['buoy_years']:.1f} buoy-years; {n['not_scored_ambiguous']} ambiguous labels not scored"
    return "\n".join([head, "-" * len(head), *_columns(table), "", *lines, ""])


def _cell(share: dict[str, Any]) -> str:
    if not share["n"]:
        return "-"
    return f"{share['count']}/{share['n']} [{share['low']:.2f}, {share['high']:.2f}]"


def _rate(rate: dict[str, float]) -> str:
    return f"{rate['count']:.0f} = {rate['per_year']:.3f} per buoy-year [{rate['low']:.3f}, {rate['high']:.3f}]"


def _days(delays: dict[str, Any]) -> str:
    if delays["median"] is None:
        return "no such label"
    each = ", ".join("never" if d is None else str(d) for d in delays["each"])
    return f"median {delays['median']:g} days, worst {delays['worst']:g} ({each})"


def _brier_text(brier: dict[str, Any]) -> str:
    low, high = brier["interval"]
    return f"{brier['value']:.4f} (n = {brier['n']}; resampled 95 % [{low:.4f}, {high:.4f}])"


def _columns(table: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]


def _labels(scores: Sequence[Score]) -> list[str]:
    table = [LABEL_COLUMNS]
    for score in scores:
        for row in sorted([*score.rows, *score.ambiguous], key=lambda r: r.label.first_outside):
            delays = [_day(d) for d in (row.warned, row.not_holding, row.moved, row.held_after)]
            label = row.label.kind + ("" if row.label.kind in ROWS else " (not scored)")
            when = _date(row.label.first_outside)
            peers = (_day(row.plain), _day(row.circle))
            table.append((score.track.site.name, when, label, row.called, *delays, f"{row.day_2:.3f}", *peers))
    return ["Each label (days from the first day outside; negative = before it)", *_columns(table), ""]


def _day(delay: int | None) -> str:
    return "-" if delay is None else str(delay)


def _date(day: float) -> str:
    return str(np.datetime64(int(day), "D"))


def _alarms(scores: Sequence[Score]) -> list[str]:
    out = ["Other failure alarms, each with its track (km north, km east of the neutral point; P = P(not holding))"]
    for score in scores:
        for i in score.other_alarms:
            out += [alarm_title(score, i), *(f"  {line}" for line in alarm_track(score, i)), ""]
    return out if any(s.other_alarms for s in scores) else [out[0], "none", ""]


def alarm_title(score: Score, event: int) -> str:
    """Name one alarm: site, day of the warning, cause, greatest distance."""
    found = score.track.events[event]
    day = _date(score.track.day[int(np.searchsorted(score.track.verdict.time, found.detected))])
    size = (found.size or 0.0) / 1000.0
    cause, peak = found.evidence["cause"], found.evidence["peak"]
    return f"{score.track.site.name} {day}: cause {cause}, as far as {size:.1f} km, peak P {peak:.3f}"


def alarm_rows(score: Score, event: int, before: int = 3, after: int = 5) -> np.ndarray:
    """Return the rows of the fixes of one warning with a few before and after."""
    verdict = score.track.verdict
    fixes = np.flatnonzero(verdict.seen)
    mine = np.flatnonzero(verdict.episode[fixes] == event)
    return np.asarray(fixes[max(mine[0] - before, 0) : mine[-1] + 1 + after])


def alarm_track(score: Score, event: int) -> list[str]:
    """Return one line a fix: date, position about the neutral point held at the warning, what is said."""
    track, verdict = score.track, score.track.verdict
    rows = alarm_rows(score, event)
    centre = verdict.neutral[rows[verdict.episode[rows] == event][0]]
    lines = []
    for r in rows:
        place = f"{(track.north[r] - centre[0]) / 1000:8.1f} {(track.east[r] - centre[1]) / 1000:8.1f}"
        lines.append(f"{_date(track.day[r])} {place}   P {verdict.not_holding[r]:.3f}  {CALLS[verdict.call[r]]}")
    return lines


def summary(scores: Sequence[Score], run: RunConfig) -> dict[str, Any]:
    """Return the whole result as JSON-safe values."""
    return {
        "kind": "adrift",
        "version": __version__,
        "caveat": CAVEAT,
        "matching": MATCHING,
        "settings": run.bank.adrift.model_dump(mode="json"),
        "run_digest": run.digest(),
        "logs": {s.track.site.name: s.track.source.sha256 for s in scores},
        "sites": [numbers([s]) | {"tuned_on": s.track.site.tuned_on} for s in scores],
        "together": numbers(scores),
        "labels": [_label_row(s, r) for s in scores for r in (*s.rows, *s.ambiguous)],
        "other_failure_alarms": [
            {"title": alarm_title(s, i), "track": alarm_track(s, i)} for s in scores for i in s.other_alarms
        ],
    }


def _label_row(score: Score, row: Row) -> dict[str, Any]:
    return {
        "site": score.track.site.name,
        "first_day_outside": _date(row.label.first_outside),
        "label": row.label.kind,
        "scored": row.label.kind in ROWS,
        "called": row.called,
        "warned": row.warned,
        "not_holding": row.not_holding,
        "moved": row.moved,
        "held_after": row.held_after,
        "p_not_holding_day_2": row.day_2,
        "plain_rule": row.plain,
        "fixed_circle": row.circle,
    }


def markdown(body: str, scores: Sequence[Score]) -> str:
    """Return the text as a Markdown page with its figures."""
    from mooringdx.assess.adrift_figures import names

    pictures = [f"![{title}]({name})" for score in scores for name, title in names(score)]
    return "\n".join(["# Adrift or moved", "", "```text", body.rstrip(), "```", "", *pictures, ""])
