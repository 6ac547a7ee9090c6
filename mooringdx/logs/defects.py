"""Clean one signal on its own clock, and say what had to be left out: stamps, non-finite values, range, spikes, gaps.

Nothing is repaired in silence: every count becomes a row of checks, and every stretch a `Defect`. What is left out is
missing afterwards; whether a hole is then bridged is decided where the signal is put on the uniform clock.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mooringdx.channels import entry
from mooringdx.logs.spikes import find_spikes
from mooringdx.logs.stamps import find_steps, order, period_of
from mooringdx.types import Array, Check, Defect, Mask, Signal

MOST_GAPS = 200
WORDS = {
    "nonfinite": ("non-finite values", 1.0, "look at the sensor, or at how the log marks missing values"),
    "duplicate": ("duplicate stamps", 1.0, "the first sample of each stamp is kept; look at the logger"),
    "out_of_order": ("out-of-order stamps", 1.0, "samples were sorted by stamp; look at how the log was written"),
    "clock_step": ("clock steps", 0.0, "synchronise the logger's clock before the test, not during it"),
    "range": ("plausible range", 1.0, "check the unit and the mapping of the channel"),
    "spike": ("spikes", 1.0, "look at the cable and the sensor; raise clock.spike_sd if the excursions are real"),
    "gap": ("gaps", 5.0, "gaps are masked; no alarm can come from inside one"),
    "stuck": ("stuck channels", 0.0, "the stretch is masked; look at the sensor"),
    "delay": ("clock lag between groups", 0.0, "the group was shifted by the lag; synchronise the clocks"),
}


@dataclass(frozen=True)
class Cleaned:
    """One signal in order, without what was left out. ``period``: s; ``logged``: samples before cleaning."""

    signal: Signal
    period: float
    logged: int
    left_out: Mapping[str, int] = field(default_factory=dict)


def clean(
    signals: Mapping[str, Signal], spike_sd: float, max_gap: float
) -> tuple[dict[str, Cleaned], tuple[Defect, ...]]:
    """Return the cleaned signals, and a defect for each kind of damage to each of them (those of one clock joined)."""
    steps = {name: find_steps(s.time[np.isfinite(s.time)], max_gap) for name, s in signals.items()}
    shared = all(steps[name] for name, s in signals.items() if s.time.size)
    out: dict[str, Cleaned] = {}
    defects: list[Defect] = []
    for name, signal in signals.items():
        placed = Signal(name, *_finite_stamps(signal), signal.unit, signal.source)
        ordered = order(placed.time, placed.values, steps[name], shared)
        values = placed.values[ordered.index]
        bad_range, values = _range(name, values)
        time, values = ordered.time[~bad_range], values[~bad_range]
        period = period_of(time)
        spikes, crowded = find_spikes(time, values, spike_sd, max_gap)
        counts = {
            "nonfinite": signal.time.size - int(np.count_nonzero(np.isfinite(placed.values))),
            "duplicate": ordered.doubled,
            "out_of_order": ordered.late,
            "clock_step": ordered.far + ordered.overlapped,
            "range": int(np.count_nonzero(bad_range)),
            "spike": int(np.count_nonzero(spikes)),
        }
        kept = Signal(name, time[~spikes], values[~spikes], signal.unit, signal.source)
        out[name] = Cleaned(kept, period, signal.time.size, counts)
        defects += _found(name, counts, ordered.time, time, {"range": bad_range, "spike": spikes}, crowded)
        word = "the log was continued" if shared else "overlapping samples were left out"
        defects += [
            Defect("clock_step", (name,), s.before, s.before, -s.size, "s", f"set back by {s.size:.3g} s; {word}")
            for s in ordered.steps
        ]
    return out, merge(defects)


def _finite_stamps(signal: Signal) -> tuple[Array, Array]:
    good = np.isfinite(signal.time)
    return (signal.time, signal.values) if good.all() else (signal.time[good], signal.values[good])


def _range(name: str, values: Array) -> tuple[Mask, Array]:
    """Return what lies outside the catalogue's range, and the values with angles unwrapped."""
    info = entry(name)
    bad = (values < info.range[0]) | (values > info.range[1])
    if info.angle and values.size:
        unwrapped = np.array(values)
        unwrapped[~bad] = np.unwrap(values[~bad])
        return bad, unwrapped
    return bad, values


def _found(
    name: str, counts: Mapping[str, int], before: Array, after: Array, masks: Mapping[str, Mask], crowded: int
) -> Iterable[Defect]:
    clocks = {"range": before, "spike": after}
    for mode in ("duplicate", "out_of_order", "range", "spike"):
        if counts[mode]:
            at = clocks[mode][masks[mode]] if mode in masks else before
            start, stop = (float(at[0]), float(at[-1])) if at.size else (float("nan"), float("nan"))
            text = f"{counts[mode]} samples"
            yield Defect(mode, (name,), start, stop, float(counts[mode]), "samples", text)
    if crowded:
        text = f"{crowded} spikes too close together to be isolated; kept"
        yield Defect("spike", (name,), float(after[0]), float(after[-1]), float(crowded), "spikes", text)


def find_gaps(cleaned: Mapping[str, Cleaned], start: float, stop: float, max_gap: float) -> tuple[Defect, ...]:
    """Return the gaps of every signal between ``start`` and ``stop``, s, joined by clock; beyond 200, in one."""
    gaps: list[Defect] = []
    for name, c in cleaned.items():
        time = c.signal.time
        if time.size == 0:
            gaps.append(Defect("gap", (name,), start, stop, stop - start, "s", "no usable sample at all"))
            continue
        edges = np.concatenate(([start - c.period], time, [stop + c.period])) if time.size > 1 else time
        limit = gap_limit(c.period, max_gap)
        spacing = np.diff(edges)
        wide = np.flatnonzero(spacing > limit)
        for k in wide[:MOST_GAPS]:
            a, b = max(float(edges[k]), start), min(float(edges[k + 1]), stop)
            gaps.append(Defect("gap", (name,), a, b, b - a, "s", f"no sample for {b - a:.4g} s"))
        if wide.size > MOST_GAPS:
            a, total = float(edges[wide[MOST_GAPS]]), float(np.sum(spacing[wide[MOST_GAPS:]]))
            text = f"{wide.size - MOST_GAPS} more gaps"
            gaps.append(Defect("gap", (name,), a, stop, total, "s", text))
    return merge(gaps)


def gap_limit(period: float, max_gap: float) -> float:
    """Return the spacing above which a signal has a gap, s: the largest gap, or 1.5 periods of a slower signal."""
    return max(max_gap, 1.5 * period if np.isfinite(period) else max_gap) * (1.0 + 1e-9)


def merge(defects: Sequence[Defect]) -> tuple[Defect, ...]:
    """Join defects that differ in the channel only, in order of their start."""
    joined: dict[tuple[object, ...], Defect] = {}
    for d in defects:
        key = (d.mode, repr(d.start), repr(d.stop), d.value, d.detail)
        known = joined.get(key)
        joined[key] = d if known is None else replace(known, subjects=known.subjects + d.subjects)
    return tuple(sorted(joined.values(), key=lambda d: (d.start, d.mode, d.subjects)))


def check_rows(cleaned: Mapping[str, Cleaned], defects: Sequence[Defect], span: float) -> tuple[Check, ...]:
    """Return one row a kind of damage, with the worst channel's share in % and the counts per channel."""
    return tuple(_row(kind, cleaned, [d for d in defects if d.mode == kind], span) for kind in WORDS)


def _row(kind: str, cleaned: Mapping[str, Cleaned], found: Sequence[Defect], span: float) -> Check:
    name, limit, remedy = WORDS[kind]
    counts = {n: c.left_out.get(kind, 0) for n, c in cleaned.items()}
    touched = sorted({s for d in found for s in d.subjects} | {n for n, k in counts.items() if k})
    if kind in ("stuck", "delay", "clock_step"):
        value, unit = float(sum(d.alarming or kind == "clock_step" for d in found)), ""
        value += sum(c > 0 for c in counts.values()) if kind == "clock_step" and not found else 0
        text = "; ".join(f"{', '.join(d.subjects)} at {d.start:.4g} s: {d.detail}" for d in _first(found))
    elif kind == "gap":
        lost = {n: sum(d.value for d in found if n in d.subjects) for n in touched}
        value, unit = 100.0 * max(lost.values(), default=0.0) / span, "%"
        text = ", ".join(f"{n} {sum(n in d.subjects for d in found)} ({lost[n]:.4g} s)" for n in touched)
    else:
        share = {n: 100.0 * k / max(cleaned[n].logged, 1) for n, k in counts.items()}
        value, unit = max(share.values(), default=0.0), "%"
        text = ", ".join(f"{n} {counts[n]}" for n in touched if counts[n])
        text = "; ".join([text, *(f"{', '.join(d.subjects)}: {d.detail}" for d in found if d.unit == "spikes")]).strip(
            "; "
        )
    passed = value <= limit
    return Check(
        name, ", ".join(touched) or "all", passed, text or "none", value, limit, unit, "" if passed else remedy
    )


def _first(found: Sequence[Defect], most: int = 5) -> Sequence[Defect]:
    return sorted(found, key=lambda d: (not d.alarming, -d.value))[:most]
