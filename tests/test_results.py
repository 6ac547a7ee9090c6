"""Truth: the round trip. What is saved comes back, byte for byte the second time; strangers' files are left alone."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mooringdx import results
from mooringdx.errors import ReportError
from mooringdx.types import Check, Event, Fault, Rival, Signatures

EVENT = Event(
    kind="line_lost",
    subject="line_4",
    onset=12.5,
    onset_interval=(12.0, 13.0),
    detected=13.1,
    size=-4.0,
    size_interval=(-4.1, -3.9),
    rivals=(Rival("sensor_fault", "tension_4", 0.01, "the vessel moved"),),
    evidence={"detector": "glrt", "peak": 30.0},
    marks=("extrapolated_threshold",),
)


def test_nouns_survive_the_round_trip_through_json() -> None:
    assert results.decode(Event, results.encode(EVENT)) == EVENT
    check = Check("gaps", "north", False, "2 gaps", value=math.nan, limit=1.0, unit="s", remedy="mask them")
    back = results.decode(Check, results.encode(check))
    assert back.value is None  # not known and not a number are the same in JSON
    assert back.remedy == check.remedy


def test_arrays_survive_exactly_with_nan_for_null() -> None:
    matrix = np.array([[0.1, np.nan], [1 / 3, 1e-300]])
    signatures = Signatures(
        (Fault("sensor_fault", "north"), Fault("line_lost", "line_1")),
        ("a", "b"),
        matrix,
        ("m", "N"),
        matrix[0],
        matrix[1],
    )
    back = results.decode(Signatures, results.encode(signatures))
    np.testing.assert_array_equal(back.matrix, matrix)
    assert back.faults == signatures.faults


def test_files_are_written_whole_and_no_draft_is_left(tmp_path: Path) -> None:
    results.write_files(tmp_path, {"events.json": b"{}", "figures/a.png": b"x"})
    assert sorted(p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()) == [
        "events.json",
        "figures/a.png",
    ]


def test_a_folder_with_strangers_is_refused_unless_forced(tmp_path: Path) -> None:
    (tmp_path / "thesis.docx").write_text("mine")
    with pytest.raises(ReportError, match=r"thesis\.docx.*--force"):
        results.guard(tmp_path, "fit", force=False)
    results.guard(tmp_path, "fit", force=True)
    (tmp_path / "thesis.docx").unlink()
    (tmp_path / "baseline.json").write_text("{}")
    results.guard(tmp_path, "fit", force=False)


def test_missing_and_damaged_files_say_which_command_makes_them(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match="`mooringdx fit` writes it"):
        results.read_json(tmp_path / "baseline.json")
    (tmp_path / "detection.json").write_text('{"a": ')
    with pytest.raises(ReportError, match="damaged"):
        results.read_json(tmp_path / "detection.json")


def test_logs_of_one_name_get_folders_of_their_own() -> None:
    paths = [Path("a/log.csv"), Path("b/log.csv.gz"), Path("2025.03.14.csv"), Path("2025.03.15.mcap")]
    assert results.log_names(paths) == ["log", "log_2", "2025.03.14", "2025.03.15"]
