"""A run file, typed: TOML in, defaults in one place, unknown keys refused with the nearest right one."""

from __future__ import annotations

import hashlib
import json
import re
import sys
import tomllib
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)

from mooringdx.errors import ConfigError
from mooringdx.registry import did_you_mean

SECONDS = {"second": 1.0, "minute": 60.0, "hour": 3600.0, "day": 86400.0, "week": 604800.0, "month": 2592000.0}
SECONDS["year"] = 365.25 * 86400.0
VESSELS = (
    Path(__file__).resolve().parent.parent / "configs" / "vessels",  # a checkout
    Path(sys.prefix) / "share" / "mooringdx" / "vessels",  # an installed wheel
)


def parse_rate(value: object) -> float:
    """Return a rate such as "1/month" or "0.5/day" in 1/s (a month is 30 days)."""
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*/\s*(?:([0-9.]+)\s*)?([a-z]+?)s?\s*", str(value))
    if not match or match[3] not in SECONDS:
        raise ValueError(f'a rate is written like "1/month", got {value!r}; allowed periods: {", ".join(SECONDS)}')
    count, per = float(match[1]), float(match[2] or 1.0)
    if not (count > 0 and per > 0):
        raise ValueError(f'a rate must be above zero, got {value!r}; write it like "1/month"')
    return count / (per * SECONDS[match[3]])


def rate_text(rate: float) -> str:
    """Return a rate in 1/s as people say it: "1 per 30 days", "2.5 per hour"."""
    if not rate > 0.0:
        return "none"
    for word in ("hour", "day"):
        if rate * SECONDS[word] >= 0.995:
            return f"{rate * SECONDS[word]:.3g} per {word}"
    days = 1.0 / (rate * 86400.0)
    if days < 730:
        return f"1 per {days:.3g} days"
    years = days / 365.25
    return f"1 per {years:.3g} years" if years < 1000 else "less than 1 per 1000 years"


def parse_window(value: object) -> tuple[float | str, float | str]:
    """Return [start, stop) in s, or of an ISO-8601 interval "start/stop" or "start/PT1H" as two texts."""
    if isinstance(value, str):
        parts = value.split("/")
        if len(parts) != 2:
            raise ValueError(f'a window is [start, stop] in s or "2025-03-14T06:00:00Z/PT1H", got {value!r}')
        return parts[0], parts[1]
    if isinstance(value, (list, tuple)) and len(value) == 2:
        start, stop = value
        if isinstance(start, str) and isinstance(stop, str):
            return start, stop
        if float(stop) <= float(start):
            raise ValueError(f"window [{start}, {stop}] is reversed or empty; start must be below stop")
        return float(start), float(stop)
    raise ValueError(f'a window is [start, stop] in s or "2025-03-14T06:00:00Z/PT1H", got {value!r}')


def window_seconds(window: tuple[float | str, float | str], epoch_ns: int | None) -> tuple[float, float]:
    """Return a window in s on the log clock; instants need a log with absolute time (``epoch_ns``)."""
    start, stop = window
    if isinstance(start, float) and isinstance(stop, float):
        return start, stop
    if epoch_ns is None:
        raise ConfigError(
            f"window {start}/{stop} names instants but the log's time has no date; give [start, stop] in s"
        )
    first = _instant(str(start), epoch_ns)
    last = first + _duration(str(stop)) if str(stop).startswith("P") else _instant(str(stop), epoch_ns)
    if last <= first:
        raise ConfigError(f"window {start}/{stop} is reversed or empty; the start must be before the stop")
    return first, last


def _instant(text: str, epoch_ns: int) -> float:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise ConfigError(f"'{text}' is not an ISO-8601 instant such as 2025-03-14T06:00:00Z") from None
    if moment.tzinfo is None:
        raise ConfigError(f"instant '{text}' has no zone; write it with Z or +01:00")
    return moment.timestamp() - epoch_ns / 1e9


def _duration(text: str) -> float:
    match = re.fullmatch(r"P(?:(\d+)D)?(?:T(?:(\d+)H)?(?:(\d+)M)?(?:([\d.]+)S)?)?", text)
    if not match or not any(match.groups()):
        raise ConfigError(f"'{text}' is not an ISO-8601 duration such as PT1H or P1DT30M")
    d, h, m, s = (float(x or 0) for x in match.groups())
    return d * 86400 + h * 3600 + m * 60 + s


Rate = Annotated[float, BeforeValidator(parse_rate), PlainSerializer(lambda r: f"{r * 86400!r}/day")]
Window = Annotated[tuple[float | str, float | str], BeforeValidator(parse_window)]
Positive = Annotated[float, Field(gt=0)]
Chance = Annotated[float, Field(gt=0, lt=1)]
M = TypeVar("M", bound=BaseModel)


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class TimeSource(_Part):
    """Where the time stands: one column, or separate date and time columns; MCAP uses log time unless told.

    A unit that was not told is guessed from each log, so it is stored only where it was told.
    """

    column: str | None = None
    unit: str = "s"
    date_column: str | None = None
    zone: str | None = None
    field: str | None = None
    source: Literal["log_time", "publish_time", "header"] = "log_time"

    @model_serializer(mode="wrap")
    def _as_told(self, whole: SerializerFunctionWrapHandler) -> dict[str, Any]:
        body: dict[str, Any] = whole(self)
        return body if "unit" in self.model_fields_set else {k: v for k, v in body.items() if k != "unit"}


class ChannelSource(_Part):
    """Where one channel stands in the log, and its unit there."""

    column: str | None = None
    topic: str | None = None
    field: str | None = None
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0

    @model_validator(mode="after")
    def _one_place(self) -> ChannelSource:
        if (self.column is None) == (self.topic is None):
            raise ValueError("a channel needs either a column, or a topic with a field")
        if self.topic is not None and self.field is None:
            raise ValueError('a channel with a topic needs a field, such as "pose.position.x"')
        return self


class CsvOptions(_Part):
    """How a text log is written; every one is guessed when left out."""

    delimiter: str | None = None
    decimal: Literal[".", ","] | None = None
    header_row: int | None = None
    skip_rows: int = 0
    comment: str | None = None


class LogPart(_Part):
    """[log]"""

    path: str | None = None
    time: TimeSource = TimeSource()
    csv: CsvOptions = CsvOptions()


class Zero(_Part):
    """Per-log zero: the median over ``window`` is subtracted from ``channels``."""

    channels: list[str]
    window: Window


class ClockPart(_Part):
    """[clock]"""

    sample_time: Positive
    max_gap: Positive = 1.0
    zero: Zero | None = None
    groups: dict[str, list[str]] = {}
    spike_sd: Positive = 12.0
    stuck_after: Positive = 1.0
    lag_band: Annotated[float, Field(gt=0)] | None = None
    max_lag: Positive = 10.0


class MooringPart(_Part):
    """[mooring]; ``azimuth``: deg true from the vessel towards each anchor, learned from the log when left out.

    ``model``: the content of the vessel file that ``vessel`` names; `load_run` puts it here, so that a baseline holds
    all that it was learned with. ``origin``: where the neutral place of the turret (of the centre of gravity, without
    one) stands in the log's north and east, m.
    """

    vessel: str | None = None
    model: dict[str, Any] = {}
    origin: tuple[float, float] = (0.0, 0.0)
    lines: list[str] = []
    azimuth: dict[str, float] = {}


class LearnedPart(_Part):
    """[residuals.learned]"""

    channels: list[str] = []
    inputs: list[str] = []
    lags: Annotated[int, Field(ge=0, le=50)] = 0
    lag_step: Annotated[int, Field(ge=1)] = 1
    quadratic: bool = False
    ridge: Annotated[float, Field(ge=0)] = 1e-6


class PositionPart(_Part):
    """[residuals.position]"""

    channels: list[str] = ["north", "east"]
    neutral: Literal["baseline"] | list[float] = "baseline"


class TensionPart(_Part):
    """[residuals.tension]: what is learned of the lines on the no-fault window beside their statics.

    ``accuracy``: share of a line's tension to which statics and gauge are believed, however quiet that window was.
    """

    calibrate: Literal["none", "offset", "linear", "dynamic"] = "dynamic"
    accuracy: Annotated[float, Field(ge=0, lt=1)] = 0.001


class ForceBalancePart(_Part):
    """[residuals.force_balance]: s over which forces are averaged to tell a line from its sensor."""

    window: Annotated[float, Field(gt=0)] | Literal["auto"] = "auto"


class ResidualPart(_Part):
    """[residuals]"""

    use: list[str]
    parity: dict[str, str] = {}
    learned: LearnedPart = LearnedPart()
    position: PositionPart = PositionPart()
    tension: TensionPart = TensionPart()
    force_balance: ForceBalancePart = ForceBalancePart()
    faults: list[str] = []


class BaselinePart(_Part):
    """[baseline]"""

    window: Window


class Compression(_Part):
    """Tail compression of whitened residuals: Fang's smooth law, a true Huber clip, or none."""

    kind: Literal["fang", "huber", "none"] = "fang"
    k: Annotated[float, Field(gt=1)] = 3.0


class WhiteningPart(_Part):
    """[whitening]; order auto chooses among none, ARMA and ARMA + compression by the smallest fault found."""

    order: Literal["auto", "none", "bic"] | tuple[int, int] = "auto"
    compression: Compression = Compression()


class DetectorPart(_Part):
    """[detector]; times in s of log clock; auto scales with the peak period of the no-fault window.

    ``slow_drift``: N, sd of the slow drift that a healthy tension sensor may have: the slow channel looks past it.
    """

    kind: str = "glrt"
    window: Positive | Literal["auto"] = "auto"
    short_window: Positive | Literal["auto", "off"] = "auto"
    slow_window: Positive | Literal["auto", "off"] = "auto"
    adapt: Positive | Literal["auto", "off"] = "auto"
    peak_period: Positive | Literal["auto"] = "auto"
    covariance_about: Literal["mean", "zero"] = "mean"
    design_size: Positive | None = None
    slow_drift: Annotated[float, Field(ge=0)] = 0.0


class AlarmPart(_Part):
    """[alarm]"""

    rate: Rate = parse_rate("1/month")
    assurance: Annotated[float, Field(ge=0.5, lt=1)] = 0.9
    hysteresis: Annotated[float, Field(gt=0, le=1)] = 0.7
    min_duration: Annotated[float, Field(ge=0)] = 0.0


class AdriftPart(_Part):
    """[bank.adrift]; km and days: one position a day from a single-point mooring. Triples: service, drag, adrift.

    ``history``, ``learn_fixes`` count held fixes; ``radius_*``, ``warn_*``, ``held_scale``: km; ``speed_median``: km a
    day; ``*_gap``: days after which the next fix is a new departure, a buoy under warning lost, a watch circle stale.
    """

    history: Annotated[int, Field(ge=7)] = 45
    learn_fixes: Annotated[int, Field(ge=2)] = 7
    warn_distance: Positive = 5.0
    warn_factor: Positive = 2.0
    radius_prior: Positive = 1.5
    radius_weight: Positive = 10.0
    radius_floor: Positive = 0.8
    cusum_allowance: Positive = 3.0
    cusum_level: Positive = 28.0
    prior: tuple[Positive, Positive, Positive] = (0.75, 0.12, 0.13)
    stop_chance: tuple[Chance, Chance, Chance] = (0.9, 0.25, 0.03)
    jump_median: tuple[Positive, Positive, Positive] = (13.0, 8.0, 20.0)
    jump_log_sd: tuple[Positive, Positive, Positive] = (0.6, 0.6, 0.8)
    speed_median: tuple[Positive, Positive, Positive] = (8.0, 7.0, 25.0)
    speed_log_sd: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    speed_weight: Annotated[float, Field(ge=0, le=1)] = 0.3
    held_scale: Positive = 0.5
    held_dof: Positive = 3.0
    departure_chance: Chance = 0.02
    alarm: Chance = 0.9
    held: Chance = 0.9
    adrift: Chance = 0.6
    departure_gap: Positive = 3.0
    lost_gap: Positive = 15.0
    expired_gap: Positive = 30.0


class ThesisPart(_Part):
    """[bank.thesis], for thesis_dht and thesis_mle; ``covariance``: where that of each hypothesis' errors is from."""

    equations: Literal["printed", "mended"] = "printed"
    values: Literal["text", "listing"] = "text"
    covariance: Literal["simulated", "no_fault"] = "simulated"


class PeersPart(_Part):
    """[bank.peers], for imm, shared_bias, live_bias and no_bias.

    ``temper``: auto is each bank's own; ``floor``: the least probability of a hypothesis (not imm's, which has rates);
    ``memory``, ``delay``: s at full scale, of shared_bias' mean bias.
    """

    temper: Annotated[float, Field(ge=1)] | Literal["auto"] = "auto"
    floor: Annotated[float, Field(ge=0, lt=0.01)] = 1e-9
    memory: Positive = 900.0
    delay: Annotated[float, Field(ge=0)] = 120.0


class BankPart(_Part):
    """[bank]: position-only hypotheses.

    Rates are priors, of all lines together, of a step of the environment (left out: one a week, a month where wind is
    logged) and of a wave group; ``temper`` is what divides the evidence where the no-fault window is too short to tell;
    ``warning`` and ``alarm`` are log odds. ``pairs``: share of breaks that take two lines at once, 0 for none;
    ``partial``: shares of a pull whose loss is weighed too.
    ``feed_forward``: of the drift that wave probes, or heave and pitch, tell: auto on axes where it explains four
    fifths, off never, always on every axis.
    """

    use: list[str] = []
    feed_forward: Literal["auto", "off", "always"] = "auto"
    line_rate: Rate = parse_rate("1/year")
    environment_rate: Rate | None = None
    pulse_rate: Rate = parse_rate("6/hour")
    pairs: Annotated[float, Field(ge=0, lt=1)] = 0.0
    partial: list[Annotated[float, Field(gt=0, lt=1)]] = []
    temper: Annotated[float, Field(ge=1)] = 2.0
    warning: float = -3.0
    alarm: float = 0.0
    adrift: AdriftPart = AdriftPart()
    thesis: ThesisPart = ThesisPart()
    peers: PeersPart = PeersPart()


class RunConfig(_Part):
    """A run file, complete with its defaults."""

    log: LogPart = LogPart()
    channels: dict[str, ChannelSource]
    clock: ClockPart
    mooring: MooringPart = MooringPart()
    residuals: ResidualPart = ResidualPart(use=[])
    baseline: BaselinePart | None = None
    whitening: WhiteningPart = WhiteningPart()
    detector: DetectorPart = DetectorPart()
    alarm: AlarmPart = AlarmPart()
    bank: BankPart = BankPart()

    def digest(self) -> str:
        """Return the sha256 of everything that changes a result (not of where the log stands)."""
        body = self.model_dump(mode="json")
        body["log"].pop("path")
        return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def load_run(path: Path) -> RunConfig:
    """Read a run file; every fault in it is one ConfigError sentence with file, key, what is allowed."""
    return validate(RunConfig, with_vessel(read_toml(path), path), path)


def with_vessel(body: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return a run file's content with the vessel file that it names read into [mooring] model."""
    mooring = body.get("mooring")
    if not isinstance(mooring, dict) or not isinstance(mooring.get("vessel"), str) or mooring.get("model"):
        return body
    return {**body, "mooring": {**mooring, "model": read_toml(vessel_file(mooring["vessel"], path))}}


def vessel_file(name: str, path: Path) -> Path:
    """Return the file of a vessel: a path relative to the file ``path`` that names it, or a name in configs/vessels."""
    beside = path.parent / name
    if name.endswith(".toml") or beside.is_file():
        if beside.is_file():
            return beside
        raise ConfigError(
            f"{path}: no vessel file {beside}; give a path relative to this file, or a name: {_vessels()}"
        )
    for folder in VESSELS:
        if (folder / f"{name}.toml").is_file():
            return folder / f"{name}.toml"
    raise ConfigError(
        f"{path}: unknown vessel '{name}'{did_you_mean(name, _vessels())}; or give a path to a vessel file"
    )


def _vessels() -> list[str]:
    return sorted({p.stem for folder in VESSELS for p in folder.glob("*.toml")})


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file, or raise a ConfigError that says where it breaks."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; `mooringdx init LOG -o {path.name}` writes a starter") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None


def validate(model: type[M], body: dict[str, Any], path: Path) -> M:
    """Return ``body`` as ``model``; the first fault becomes one sentence."""
    try:
        return model.model_validate(body)
    except ValidationError as error:
        raise ConfigError(f"{path}: {_sentence(model, error)}") from None


def _sentence(model: type[BaseModel], error: ValidationError) -> str:
    found = error.errors(include_url=False)
    first = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
    where = ".".join(str(x) for x in first["loc"])
    if first["type"] == "extra_forbidden":
        allowed = _fields_at(model, first["loc"][:-1])
        place = ".".join(str(x) for x in first["loc"][:-1]) or "top level"
        return f"unknown key '{first['loc'][-1]}' in [{place}]{did_you_mean(str(first['loc'][-1]), allowed)}"
    if first["type"] == "missing":
        return f"key '{where}' is missing and has no default"
    said = first["msg"].removeprefix("Value error, ")
    return f"'{where}': {said}" if where else said


def _fields_at(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    here: Any = model
    for key in loc:
        found = getattr(here, "model_fields", {}).get(str(key))
        if found is None:
            break
        here = found.annotation
        for part in getattr(here, "__args__", ()):
            if isinstance(part, type) and issubclass(part, BaseModel):
                here = part
    return list(getattr(here, "model_fields", {}))
