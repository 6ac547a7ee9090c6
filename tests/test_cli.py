"""Truth: the contract of docs/interface.md: exit statuses, one sentence an error, JSON alone on standard output."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import jsonschema
import pytest
from click.testing import CliRunner, Result

from mooringdx.cli import main

ROOT = Path(__file__).parents[1]
QUICK = '[whitening]\norder = "none"\n'


def call(*words: object) -> Result:
    return CliRunner().invoke(main, [str(w) for w in words])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a user's own: the demo log under another name, and a quick run file."""
    folder = tmp_path_factory.mktemp("user")
    shutil.copy(ROOT / "data/demo.csv", folder / "tank.csv")
    text = (ROOT / "configs/runs/demo.toml").read_text().replace("../../data/demo.csv", "tank.csv")
    (folder / "run.toml").write_text(text + QUICK if "[whitening]" not in text else text)
    return folder


@pytest.fixture(scope="module")
def done(place: Path) -> Path:
    """The folder of one whole run."""
    result = call("run", place / "run.toml", "-o", place / "out")
    assert result.exit_code == 3, result.output
    return place / "out"


def test_run_writes_every_file_of_the_contract(done: Path) -> None:
    for name in ("run.json", "baseline.json", "events.json", "events.csv", "stages.parquet", "report.html"):
        assert (done / name).stat().st_size > 100
    assert list((done / "figures").glob("*.png"))
    assert not list(done.rglob("*.part"))


def test_events_follow_the_schema(done: Path) -> None:
    schema = json.loads((ROOT / "mooringdx/schemas/events.schema.json").read_text())
    body = json.loads((done / "events.json").read_text())
    jsonschema.validate(body, schema)
    assert body["verdict"] == "fault_found"
    assert body["provenance"]["command"].startswith("mooringdx")


def test_the_same_input_gives_the_same_bytes(done: Path) -> None:
    before = {p.name: p.read_bytes() for p in done.iterdir() if p.is_file() and p.name != "run.json"}
    result = call("run", done.parent / "run.toml", "-o", done)
    assert result.exit_code == 3
    after = {p.name: p.read_bytes() for p in done.iterdir() if p.is_file() and p.name != "run.json"}
    assert before.keys() == after.keys()
    assert [name for name in before if before[name] != after[name]] == []


def test_detect_on_several_logs_gives_a_folder_a_log_and_a_summary(done: Path, place: Path) -> None:
    shutil.copy(place / "tank.csv", place / "second.csv")
    result = call("detect", done, place / "tank.csv", place / "second.csv", "--json")
    assert result.exit_code == 3
    assert [d["verdict"] for d in json.loads(result.stdout)] == ["fault_found", "fault_found"]
    assert {p.name for p in (done / "logs").iterdir()} == {"tank", "second"}
    assert len((done / "summary.csv").read_text().splitlines()) == 3


def test_json_is_alone_on_standard_output(place: Path) -> None:
    body = json.loads(call("inspect", place / "tank.csv", "--json").stdout)
    assert {"north", "tension_4"} <= {s["guess"] for s in body["signals"]}


def test_init_writes_a_run_file_that_fit_accepts(place: Path) -> None:
    result = call("init", place / "tank.csv", "-o", place / "own.toml")
    assert result.exit_code == 0, result.output
    assert call("fit", place / "own.toml", "-o", place / "own").exit_code == 0
    again = call("init", place / "tank.csv", "-o", place / "own.toml")
    assert again.exit_code == 2
    assert "already there" in again.stderr


def edited(place: Path, name: str, old: str, new: str) -> Path:
    path = place / name
    text = (place / "run.toml").read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('column = "tension_4"', 'column = "tension_44"', ["tension_44", "did you mean", "tank.csv"]),
        ("[60.0, 1260.0]", "[1260.0, 60.0]", ["reversed", "wrong.toml"]),
        ("sample_time", "smaple_time", ["smaple_time", "did you mean 'sample_time'"]),
        ('unit = "deg"', 'unit = "kN"', ["heading", "kN", "rad"]),
        ("tank.csv", "gone.csv", ["gone.csv"]),
        ("[60.0, 1260.0]", "[60.0, 400.0]", ["more", "--extrapolate"]),
    ],
)
def test_a_wrong_input_is_one_sentence_and_status_2(place: Path, old: str, new: str, said: list[str]) -> None:
    result = call("fit", edited(place, "wrong.toml", old, new), "-o", place / "wrong")
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    for word in said:
        assert word in result.stderr
    assert not (place / "wrong").exists()


def test_a_truncated_log_is_read_as_far_as_it_goes(place: Path) -> None:
    body = (place / "tank.csv").read_bytes()
    (place / "cut.csv").write_bytes(body[: len(body) // 3 + 7])
    result = call("inspect", place / "cut.csv")
    assert result.exit_code == 0
    assert "!" in result.stdout  # a check says what was lost


def test_missing_results_say_which_command_makes_them(tmp_path: Path) -> None:
    result = call("report", tmp_path)
    assert result.exit_code == 2
    assert "mooringdx detect" in result.stderr
    assert call("detect", tmp_path).exit_code == 2


def test_a_folder_with_strangers_is_left_alone(place: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.docx").write_text("mine")
    result = call("fit", place / "run.toml", "-o", tmp_path)
    assert result.exit_code == 2
    assert "thesis.docx" in result.stderr


def test_doctor_finds_the_installation_sound() -> None:
    assert call("doctor").exit_code == 0


def test_a_new_fit_leaves_no_result_of_an_old_one(place: Path) -> None:
    out = place / "fresh"
    assert call("run", place / "run.toml", "-o", out).exit_code == 3
    assert call("fit", place / "run.toml", "-o", out).exit_code == 0
    assert {p.name for p in out.iterdir()} == {"run.json", "baseline.json"}
    assert call("report", out).exit_code == 2
    assert call("detect", out).exit_code == 3  # its own log, found from any folder
    assert call("report", out).exit_code == 0


def test_one_bad_log_among_several_is_a_row_and_the_batch_goes_on(place: Path) -> None:
    out = place / "batch"
    assert call("fit", place / "run.toml", "-o", out).exit_code == 0
    (place / "2025.03.14.csv").write_bytes((place / "tank.csv").read_bytes())
    (place / "2025.03.15.csv").write_text("not;a;log\n1;2;3\n")
    result = call("detect", out, place / "2025.03.14.csv", place / "2025.03.15.csv", place / "tank.csv")
    assert result.exit_code == 2
    rows = (out / "summary.csv").read_text().splitlines()
    assert [row.split(",")[1] for row in rows[1:]] == ["fault_found", "failed", "fault_found"]
    assert {p.name for p in (out / "logs").iterdir()} == {"2025.03.14", "tank"}


def iso(seconds: float) -> str:
    return (datetime(2026, 3, 1, 6, tzinfo=UTC) + timedelta(seconds=seconds)).isoformat()


def stamped(place: Path, name: str, head: str, stamp: Callable[[float], str]) -> Path:
    """Write the demo log as of a logger with another clock."""
    header, *rows = (place / "tank.csv").read_text().splitlines()
    cells = (row.split(",", 1) for row in rows)
    lines = [f"{head},{header.split(',', 1)[1]}", *(f"{stamp(float(t))},{rest}" for t, rest in cells)]
    (place / name).write_text("\n".join(lines) + "\n")
    return place / name


def test_detect_reads_a_clock_that_was_guessed_as_fit_did(done: Path, place: Path) -> None:
    logs = [
        stamped(place, "iso.csv", "Clock", iso),
        stamped(place, "stamp.csv", "Stamp", iso),
        stamped(place, "minutes.csv", "Clock [min]", lambda t: repr(t / 60.0)),
    ]
    run_file = edited(place, "clock.toml", 'time = { column = "time", unit = "s" }', "")
    run_file.write_text(run_file.read_text().replace("tank.csv", "iso.csv"))
    out = place / "clock"
    assert call("fit", run_file, "-o", out).exit_code == 0
    assert json.loads((out / "run.json").read_text())["time"] == ["column 'Clock' is read as time in iso8601"]
    own = call("detect", out, "--json")
    assert own.exit_code == 3, own.output
    told = json.loads(call("detect", done, place / "tank.csv", "--json").stdout)
    wanted = [(e["kind"], e["subject"], e["onset"]) for e in told["events"]]
    assert wanted
    others = call("detect", out, *logs[1:], "--json")
    assert others.exit_code == 3, others.output
    for body in (json.loads(own.stdout), *json.loads(others.stdout)):
        assert [(e["kind"], e["subject"]) for e in body["events"]] == [w[:2] for w in wanted]
        assert [e["onset"] for e in body["events"]] == pytest.approx([w[2] for w in wanted], abs=0.2)


def test_a_clock_that_was_told_is_not_guessed_anew(done: Path, place: Path) -> None:
    result = call("detect", done, stamped(place, "told.csv", "Clock", iso))
    assert result.exit_code == 2
    assert "no column 'time'" in result.stderr


def test_without_tensions_a_vessel_is_drafted_by_position_and_the_error_points_there(place: Path) -> None:
    rows = [row.split(",") for row in (place / "tank.csv").read_text().splitlines()]
    kept = [i for i, head in enumerate(rows[0]) if not head.startswith("tension_")]
    (place / "bare.csv").write_text("\n".join(",".join(row[i] for i in kept) for row in rows) + "\n")
    result = call("init", place / "bare.csv", "-o", place / "bare.toml", "--vessel", "cybership3")
    assert result.exit_code == 0, result.output
    result = call("fit", place / "bare.toml", "-o", place / "bare")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("position-only bank")
    text = (place / "bare.toml").read_text().replace('[bank]\nuse = ["onset_glr"]', '[residuals]\nuse = ["tension"]')
    (place / "asked.toml").write_text(text)
    result = call("fit", place / "asked.toml", "-o", place / "asked")
    assert result.exit_code == 2
    assert '[bank] use = ["onset_glr"]' in result.stderr
