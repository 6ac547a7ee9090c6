"""Save and load what `fit` and `detect` produced.

A folder holds run.json (configuration, logs, versions, command), baseline.json (all that `fit` learned),
detection.json and stages.parquet (every stage of the walk), events.json and events.csv (the contract), report.html
and figures/. Every file is written under a temporary name and renamed; the same input gives the same bytes.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import re
import shutil
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mooringdx.errors import ReportError
from mooringdx.types import Array, Channels, Detection, Mask, Posterior, Residuals, Signatures, Statistic, Whitened

T = TypeVar("T")
_ROW_GROUP = 131_072
ENDINGS = (".csv", ".txt", ".tsv", ".dat", ".out", ".gz", ".zst", ".parquet", ".mcap")

#: The files of each stage; a command replaces only those of its own stage.
STAGES: Mapping[str, tuple[str, ...]] = {
    "fit": ("run.json", "baseline.json"),
    "detect": ("detection.json", "stages.parquet", "events.json", "events.csv", "summary.csv", "logs"),
    "report": ("report.html", "figures"),
}


def write_files(folder: Path, files: Mapping[str, bytes | memoryview]) -> None:
    """Write files below ``folder`` atomically: each under a temporary name, then all renamed."""
    staged = []
    for name, body in files.items():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        draft = target.with_name(f".{target.name}.part")
        draft.write_bytes(body)
        staged.append((draft, target))
    for draft, target in staged:
        os.replace(draft, target)


def guard(folder: Path, stage: str, force: bool) -> None:
    """Refuse to write into a folder that holds anything but this program's own files.

    Raises ReportError naming the first stranger, unless ``force``.
    """
    if force or not folder.exists():
        return
    if not folder.is_dir():
        raise ReportError(f"{folder}: is a file, not a folder; give another -o DIR")
    known = {name for names in STAGES.values() for name in names}
    for item in sorted(folder.iterdir()):
        if item.name not in known and not item.name.startswith("."):
            raise ReportError(
                f"{folder}: holds '{item.name}', which {stage} did not write; give another -o DIR, or --force"
            )


def clear(folder: Path, stage: str) -> None:
    """Remove what ``stage`` and later stages left in a folder: no result of another run may stay beside a new one."""
    stages = list(STAGES)
    for later in stages[stages.index(stage) :]:
        for name in STAGES[later]:
            target = folder / name
            if target.is_dir():
                shutil.rmtree(target)
            else:
                target.unlink(missing_ok=True)


def log_names(paths: Sequence[Path]) -> list[str]:
    """Return a folder name a log: its file name without the endings of logs; alike names get their number.

    ``2025.03.14.csv.gz`` becomes ``2025.03.14``; two logs ``a/log.csv`` and ``b/log.csv`` become ``log`` and ``log_2``.
    """
    out: list[str] = []
    for path in paths:
        stem = path.name
        while Path(stem).suffix.lower() in ENDINGS and Path(stem).stem:
            stem = Path(stem).stem
        taken = sum(1 for name in out if name == stem or re.fullmatch(re.escape(stem) + r"_\d+", name))
        out.append(f"{stem}_{taken + 1}" if taken else stem)
    return out


def json_bytes(body: Any) -> bytes:
    """Return canonical JSON bytes: sorted as given, NaN and infinities as null, a closing newline."""
    return (json.dumps(encode(body), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def encode(value: Any) -> Any:
    """Return a noun, array or mapping as JSON-safe values; NaN and infinities become null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: encode(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return encode(value.tolist())
    if isinstance(value, np.generic):
        return encode(value.item())
    if isinstance(value, Mapping):
        return {str(k): encode(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [encode(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def decode(kind: Any, value: Any) -> Any:
    """Rebuild a noun of type ``kind`` from `encode`'s output; null in a numeric array is NaN again."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        hints = typing.get_type_hints(kind)
        return kind(
            **{f.name: decode(hints[f.name], value[f.name]) for f in dataclasses.fields(kind) if f.name in value}
        )
    if origin is tuple:
        if len(parts) == 2 and parts[1] is Ellipsis:
            return tuple(decode(parts[0], v) for v in value)
        return tuple(decode(p, v) for p, v in zip(parts, value, strict=True))
    if origin is np.ndarray:
        return np.array(value, dtype=np.float64)
    if parts and type(None) in parts:
        inner = next(p for p in parts if p is not type(None))
        return None if value is None else decode(inner, value)
    if kind is float:
        return math.nan if value is None else float(value)
    return value


def read_json(path: Path) -> Any:
    """Read one of our JSON files, or raise a ReportError that says which command makes it."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        maker = next((stage for stage, names in STAGES.items() if path.name in names), "run")
        raise ReportError(f"{path}: not there; `mooringdx {maker}` writes it") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ReportError(f"{path}: damaged ({error}); run the command that made it again") from None


def detection_files(detection: Detection) -> dict[str, bytes | memoryview]:
    """Return detection.json and stages.parquet."""
    big = {"channels", "residuals", "forces", "whitened", "statistics", "posteriors"}
    head = {f.name: getattr(detection, f.name) for f in dataclasses.fields(detection) if f.name not in big}
    c, r, w = detection.channels, detection.residuals, detection.whitened
    head["channels"] = {f: getattr(c, f) for f in ("names", "units", "grid", "source", "checks", "defects")}
    head["residuals"] = r and {f: getattr(r, f) for f in ("names", "units", "signatures")}
    b = detection.forces
    head["forces"] = b and {f: getattr(b, f) for f in ("names", "units", "signatures")}
    head["whitened"] = w and {f: getattr(w, f) for f in ("names", "signatures", "kind")}
    head["statistics"] = [{"branch": s.branch, "labels": s.labels} for s in detection.statistics]
    head["posteriors"] = [{"bank": p.bank, "hypotheses": p.hypotheses} for p in detection.posteriors]
    return {"detection.json": json_bytes(head), "stages.parquet": _stages(detection)}


def load_detection(folder: Path) -> Detection:
    """Rebuild the Detection that `detection_files` wrote; values come back in single precision."""
    import pyarrow.parquet as pq

    head = read_json(folder / "detection.json")
    path = folder / "stages.parquet"
    try:
        table = pq.read_table(path)
    except (OSError, ValueError) as error:
        raise ReportError(f"{path}: cannot be read ({error}); run `mooringdx detect` again") from None
    columns = {n: table.column(n).to_numpy().astype(np.float64) for n in table.column_names}

    def block(prefix: str, names: Iterable[str]) -> Array:
        picked = [columns[f"{prefix}/{name}"] for name in names]
        return np.column_stack(picked) if picked else np.zeros((table.num_rows, 0))

    hints = typing.get_type_hints(Detection)
    rest = {f.name: f for f in dataclasses.fields(Detection)}
    ch = head["channels"]
    values = block("channel", ch["names"])
    shell = typing.get_type_hints(Channels)
    fields = {k: decode(shell[k], ch[k]) for k in ("names", "units", "grid", "source", "checks", "defects")}
    channels = Channels(values=values, valid=np.isfinite(values), **fields)
    grid = channels.grid
    kept: dict[str, Residuals | None] = {"residuals": None, "forces": None}
    for word, prefix in (("residuals", "residual"), ("forces", "force")):
        if head[word]:
            v = block(prefix, head[word]["names"])
            names, units = tuple(head[word]["names"]), tuple(head[word]["units"])
            kept[word] = Residuals(names, units, grid, v, np.isfinite(v), _signatures(head[word]))
    whitened = None
    if head["whitened"]:
        v = block("whitened", head["whitened"]["names"])
        names = tuple(head["whitened"]["names"])
        whitened = Whitened(names, grid, v, np.isfinite(v), _signatures(head["whitened"]), head["whitened"]["kind"])
    statistics = tuple(
        Statistic(s["branch"], tuple(s["labels"]), grid, block(f"statistic/{s['branch']}", s["labels"]))
        for s in head["statistics"]
    )
    posteriors = []
    for p in head["posteriors"]:
        v = block(f"posterior/{p['bank']}", p["hypotheses"])
        rows = np.isfinite(v).all(axis=1)
        posteriors.append(Posterior(p["bank"], tuple(p["hypotheses"]), grid.time[rows], v[rows]))
    built: dict[str, Any] = {
        "channels": channels,
        **kept,
        "whitened": whitened,
        "statistics": statistics,
        "posteriors": tuple(posteriors),
    }
    for name in rest.keys() - built.keys():
        built[name] = decode(hints[name], head[name])
    return Detection(**built)


def _signatures(head: Mapping[str, Any]) -> Signatures:
    out = decode(Signatures, head["signatures"])
    assert isinstance(out, Signatures)
    return out


def _stages(detection: Detection) -> memoryview:
    """Return stages.parquet, built one row group at a time, in single precision but for the time."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    grid = detection.channels.grid
    blocks: list[tuple[list[str], Array, Mask | None]] = [(["time"], grid.time[:, None], None)]

    def put(prefix: str, names: Iterable[str], values: Array, valid: Mask | None = None) -> None:
        blocks.append(([f"{prefix}/{name}" for name in names], values, valid))

    put("channel", detection.channels.names, detection.channels.values, detection.channels.valid)
    if detection.residuals is not None:
        put("residual", detection.residuals.names, detection.residuals.values, detection.residuals.valid)
    if detection.forces is not None:
        put("force", detection.forces.names, detection.forces.values, detection.forces.valid)
    if detection.whitened is not None:
        put("whitened", detection.whitened.names, detection.whitened.values, detection.whitened.valid)
    for s in detection.statistics:
        put(f"statistic/{s.branch}", s.labels, s.values)
    for p in detection.posteriors:
        full = np.full((grid.n, len(p.hypotheses)), np.nan)
        full[np.rint((p.time - grid.start) / grid.sample_time).astype(np.int64)] = p.probability
        put(f"posterior/{p.bank}", p.hypotheses, full)

    def rows(part: slice) -> pa.Table:
        columns = {}
        for names, values, valid in blocks:
            piece = values[part] if valid is None else np.where(valid[part], values[part], np.nan)
            kind = np.float64 if names == ["time"] else np.float32
            columns.update({name: np.ascontiguousarray(piece[:, i], dtype=kind) for i, name in enumerate(names)})
        return pa.table(columns)

    out = pa.BufferOutputStream()
    first = rows(slice(0, _ROW_GROUP))
    with pq.ParquetWriter(out, first.schema, compression="zstd", compression_level=1, use_dictionary=False) as writer:
        writer.write_table(first)
        for start in range(_ROW_GROUP, grid.n, _ROW_GROUP):
            writer.write_table(rows(slice(start, start + _ROW_GROUP)))
    return memoryview(out.getvalue())
