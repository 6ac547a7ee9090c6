"""Guess the catalogue name of a logged quantity from its column or field name and its unit.

A guess is a suggestion for a person to check, never used without a run file that states it. A name that fits no rule,
or whose unit is of another dimension than the catalogue's, becomes a free channel ``x_<name>``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mooringdx.channels import entry, to_si, unit_in_header
from mooringdx.errors import ConfigError

TIME_WORDS = frozenset(
    ("t", "time", "stamp", "timestamp", "date", "datetime", "epoch", "utc", "sec", "seconds", "elapsed")
)
# Pattern on the spelled name (lower case, words joined by one underscore) -> catalogue name (\\1: line or number), why.
X = "x, taken as north (in an east-north-up log x is east)"
Y = "y, taken as east (in an east-north-up log y is north)"
Z = "z, taken as down (in an east-north-up log z is up)"
RULES: tuple[tuple[str, str, str], ...] = (
    (r"(?:mooring_)?(?:line_)?(?:(?:fairlead_)?tension|ten|fair_?ten)s?_(\w+)", "tension_\\1", "tension"),
    (r"(?:load_?cell|lc|last|kraft|zug)s?_(\w+)", "tension_\\1", "load cell"),
    (r"(?:mooring_|mooring_line_|line_)(\d+)(?:_tension|_load|_force|_ten)?", "tension_\\1", "numbered line"),
    (r"(?:t|f_?line|ml|l)_(\d+)", "tension_\\1", "numbered tension"),
    (r"(?:line_length|length_line|line_len|l_line|payout)_(\w+)", "line_length_\\1", "line length"),
    (r"(?:pos_|position_)?(?:north|northing|n)(?:_pos|_position)?", "north", "north"),
    (r"(?:pos_|position_)?(?:east|easting|e)(?:_pos|_position)?", "east", "east"),
    (r"(?:pos_|position_)?down", "down", "down"),
    (r"(?:pose_)*(?:pos_|position_)?x(?:_pos|_position)?", "north", X),
    (r"(?:pose_)*(?:pos_|position_)?y(?:_pos|_position)?", "east", Y),
    (r"(?:pose_)*(?:pos_|position_)?z(?:_pos|_position)?", "down", Z),
    (r"(?:heading|hdg|hdt|head|psi|true_heading|gyro|kurs|course)", "heading", "heading"),
    (r"(?:roll|phi)(?:_angle)?", "roll", "roll"),
    (r"(?:pitch|theta)(?:_angle)?", "pitch", "pitch"),
    (r"yaw(?:_angle)?", "yaw", "yaw"),
    (r"(surge|sway|heave)(?:_motion|_pos|_position)?", "\\1", "motion"),
    (r"(?:true_)?(?:wind|w)_?(?:speed|spd|vel|velocity|sp)|ws|wind", "wind_speed", "wind speed"),
    (r"(?:true_)?(?:wind|w)_?(?:direction|dir|from)|wd", "wind_direction", "wind direction, from"),
    (r"(?:current|cur)_?(?:speed|spd|vel|velocity)", "current_speed", "current speed"),
    (r"(?:current|cur)_?(?:direction|dir)", "current_direction", "current direction, towards"),
    (r"(?:(?:wave_)?elevation|wave_elev|eta|wave_probe|wave_gauge|wp|wg|wave)_(\d+)", "wave_elevation_\\1", "probe"),
    (r"(?:wave_elevation|wave_elev|elevation|eta|wave_probe|wave_gauge|wave)", "wave_elevation_1", "wave elevation"),
    (r"(?:hs|swh|hm_0|h_s|(?:sig_|significant_)?wave_height)", "wave_height", "wave height"),
    (r"(?:tp|t_p|wave_period|peak_period)", "wave_period", "peak period"),
    (r"(?:gps_|gnss_)?(?:lat|latitude)(?:_north|_n)?", "latitude", "latitude"),
    (r"(?:gps_|gnss_)?(?:lon|lng|long|longitude)(?:_east|_e)?", "longitude", "longitude"),
    (r"(?:tau|thrust|force_thr)_(?:x|surge)", "thrust_surge", "thrust forward"),
    (r"(?:tau|thrust|force_thr)_(?:y|sway)", "thrust_sway", "thrust to starboard"),
    (r"(?:tau|thrust|moment_thr)_(?:n|psi|yaw)", "thrust_yaw", "turning moment"),
    (r"(?:thruster|thr)_(\d+)(?:_thrust|_force)?", "thruster_\\1", "thruster"),
    (r"(?:imu_)?(?:linear_)?(?:accel|acc|acceleration|a)_?(?:x|surge)", "accel_x", "acceleration"),
    (r"(?:imu_)?(?:linear_)?(?:accel|acc|acceleration|a)_?(?:y|sway)", "accel_y", "acceleration"),
    (r"(?:imu_)?(?:linear_)?(?:accel|acc|acceleration|a)_?(?:z|heave)", "accel_z", "acceleration"),
)  # fmt: skip
_RULES = tuple((re.compile(pattern), target, why) for pattern, target, why in RULES)


@dataclass(frozen=True)
class Guess:
    """A catalogue name with the reason for it; ``known`` is False for a free channel, ``time`` True for a clock."""

    name: str
    reason: str
    known: bool
    time: bool = False


def guess_name(text: str, unit: str | None, topic: str = "") -> Guess:
    """Return the catalogue name that a quantity looks like.

    Parameters
    ----------
    text : column header (with or without its unit), or the field path of a message.
    unit : as logged; None or "" where not stated.
    topic : of the message, for fields such as ``data`` that say nothing by themselves.
    """
    bare = unit_in_header(text)[0]
    spelled = _spell(bare)
    if not topic and spelled in TIME_WORDS:
        return Guess(f"x_{spelled}", "looks like a clock", False, True)
    for candidate, original in _readings(bare, spelled, topic):
        known = _by_rule(candidate, original, unit or "")
        if known is not None:
            return known
    return Guess("x_" + _slug(f"{topic} {bare}" if topic else bare), "no catalogue name fits", False)


def guess_names(texts: Sequence[tuple[str, str | None, str]]) -> tuple[Guess, ...]:
    """Return a guess for each (text, unit, topic); of several that claim one name the first keeps it."""
    taken: set[str] = set()
    out = []
    for text, unit, topic in texts:
        guess = guess_name(text, unit, topic)
        if guess.name in taken:
            free = guess.name if not guess.known else "x_" + _slug(f"{topic} {text}" if topic else text)
            number = 2
            name = free
            while name in taken:
                name, number = f"{free}_{number}", number + 1
            why = f"{guess.name} is already taken" if guess.known else guess.reason
            guess = Guess(name, why, False, guess.time)
        taken.add(guess.name)
        out.append(guess)
    return tuple(out)


def _spell(text: str) -> str:
    """Return a name in lower case with one underscore between words: "windSpeed" -> wind_speed, "T1" -> t_1."""
    text = re.sub(r"\[(\d+)\]", lambda m: f"_{int(m[1]) + 1}", text)
    text = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", "_", text)
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", unit_in_header(text)[0].lower()).strip("_") or "channel"


def _readings(bare: str, spelled: str, topic: str) -> list[tuple[str, str]]:
    """Return the spellings to try: the whole, then, for fields, ever shorter ends and the topic's last word."""
    found = [(spelled, bare)]
    if topic:
        words = spelled.split("_")
        last = _spell(topic.rsplit("/", 1)[-1])
        shorter = [w for w in words if w not in ("data", "value", "msg", "values")]
        found += [("_".join(shorter[k:]), bare) for k in range(len(shorter))]
        found += [("_".join([last, *shorter]), bare), (re.sub(r"s_(\d+)$", r"_\1", "_".join([last, *shorter])), bare)]
        found += [(re.sub(r"s_(\d+)$", r"_\1", "_".join(shorter)), bare)]
    return [(c, o) for c, o in found if c]


def _by_rule(candidate: str, original: str, unit: str) -> Guess | None:
    if _is_catalogue(candidate) and _fits(candidate, unit):
        return Guess(_with_case(candidate, original), "its own name", True)
    for pattern, target, why in _RULES:
        found = pattern.fullmatch(candidate)
        if found:
            name = found.expand(target)
            if _is_catalogue(name) and _fits(name, unit):
                return Guess(_with_case(name, original), why, True)
    return None


def _is_catalogue(name: str) -> bool:
    try:
        return not entry(name).name.startswith(("x_", "time"))
    except ConfigError:
        return False


def _fits(name: str, unit: str) -> bool:
    if not unit:
        return True
    try:
        to_si(np.ones(1), unit, name)
    except ConfigError:
        return False
    return True


def _with_case(name: str, original: str) -> str:
    """Return ``name`` with its last word (the line) written as in the log: tension_sb of "Tension_SB" -> tension_SB."""
    head, _, tail = name.rpartition("_")
    if head in ("tension", "line_length"):
        found = re.search(rf"(?i){re.escape(tail)}$", original)
        return f"{head}_{found[0]}" if found else name
    return name
