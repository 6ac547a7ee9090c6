"""The commands: parse, call, write, one line of outcome. The only place that catches errors.

Exit status: 0 done and nothing found, 3 done and a fault found, 2 wrong input or a window that `fit` refuses, 1 the
tool failed. Every heavy import stands inside its command, so that `--help` costs a few times a bare interpreter.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from mooringdx import __version__
from mooringdx.errors import MooringdxError

if TYPE_CHECKING:
    from mooringdx.baseline import Baseline
    from mooringdx.config import RunConfig
    from mooringdx.types import Channels, Detection, RawLog

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # our matrices are small: idle threads only spin

FOUND, WRONG, FAILED = 3, 2, 1
LOG = click.Path(dir_okay=False, path_type=Path)
DIR = click.Path(file_okay=False, path_type=Path)


class Commands(click.Group):
    """A group that turns our errors into one sentence and exit status 2, and any other into status 1."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; see the class."""
        try:
            return super().invoke(ctx)
        except MooringdxError as error:
            fail(f"error: {error}", WRONG)
        except (click.exceptions.Exit, click.ClickException, click.Abort):
            raise
        except BrokenPipeError:
            sys.exit(0)
        except Exception as error:
            if ctx.params.get("debug"):
                raise
            fail(
                f"mooringdx failed: {type(error).__name__}: {error}; run again with `mooringdx --debug` for the place",
                FAILED,
            )


def fail(sentence: str, status: int) -> NoReturn:
    """Print one sentence to standard error and leave with ``status``."""
    click.echo(sentence, err=True)
    sys.exit(status)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="mooringdx")
@click.option("--debug", is_flag=True, help="Show the traceback when the tool itself fails.")
def main(debug: bool) -> None:
    """Did something break on the moored vessel: which line or which sensor, when, how badly, and how sure."""


json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on standard output.")
out_option = click.option("-o", "--out", type=DIR, required=True, help="Folder of the results.")
force_option = click.option("--force", is_flag=True, help="Write even where strangers' files stand.")
extrapolate_option = click.option(
    "--extrapolate", is_flag=True, help="Accept a no-fault window that cannot carry the asked rate; marks the report."
)


@main.command()
@click.argument("log", type=LOG)
@click.option("--html", type=LOG, help="Also write a page with a small plot of every signal.")
@json_option
def inspect(log: Path, html: Path | None, as_json: bool) -> None:
    """Show what is in LOG: signals, units, rates, spans, gaps, defects."""
    from mooringdx.logs.survey import as_dict, survey

    raw = read(log, None)
    rows = survey(raw)
    if html is not None:
        from mooringdx.plots.survey import inspect_html
        from mooringdx.results import write_files

        write_files(html.parent, {html.name: inspect_html(rows, raw).encode()})
    if as_json:
        put_json({"log": str(log), "signals": [as_dict(r) for r in rows], "checks": raw.checks})
        return
    table(
        f"{log}: {len(rows)} signals",
        ("signal", "unit", "rate", "span", "samples", "gaps", "stuck", "min", "median", "max", "looks like"),
        [survey_cells(as_dict(r)) for r in rows],
    )
    for check in raw.checks:
        click.echo(f"{'ok' if check.passed else '! '} {check.name}: {check.detail} {check.remedy}".rstrip())
    if html is not None:
        click.echo(f"wrote {html}", err=True)


@main.command()
@click.argument("log", type=LOG)
@click.option("-o", "--out", type=LOG, required=True, help="The run file to write.")
@click.option("--vessel", help="A vessel file, or its name in configs/vessels; without one the run is model-free.")
@click.option("--model-free", is_flag=True, help="Without a vessel model: what is left out when --vessel is.")
@click.option("--force", is_flag=True, help="Replace the file when it is there.")
def init(log: Path, out: Path, vessel: str | None, model_free: bool, force: bool) -> None:
    """Write a commented starter run file for LOG, with the mapping it guessed."""
    from mooringdx.errors import ConfigError
    from mooringdx.logs.starter import starter
    from mooringdx.logs.survey import survey
    from mooringdx.results import write_files

    if out.exists() and not force:
        raise ConfigError(f"{out}: is already there; give another -o, or --force to replace it")
    if vessel and model_free:
        raise ConfigError("--vessel and --model-free exclude each other; give one of them, or none")
    lines = vessel_lines(vessel, out) if vessel else ()
    raw = read(log, None)
    text = starter(log, survey(raw), vessel=vessel, lines=lines, out=out)
    write_files(out.parent, {out.name: text.encode()})
    click.echo(f"wrote {out}: check the mapping and the no-fault window, then `mooringdx run {out} -o DIR`")


@main.command()
@click.argument("run_file", type=LOG)
@click.argument("logs", type=LOG, nargs=-1)
@out_option
@extrapolate_option
@force_option
@json_option
def fit(run_file: Path, logs: Sequence[Path], out: Path, extrapolate: bool, force: bool, as_json: bool) -> None:
    """Learn the baseline on the no-fault window of RUN_FILE's log, or of all LOGS pooled."""
    from mooringdx.results import guard

    guard(out, "fit", force)
    baseline, _ = fit_logs(run_file, logs, out, extrapolate)
    if as_json:
        put_json(baseline.summary())
    else:
        click.echo(baseline.text())


@main.command()
@click.argument("folder", type=DIR)
@click.argument("logs", type=LOG, nargs=-1)
@force_option
@json_option
def detect(folder: Path, logs: Sequence[Path], force: bool, as_json: bool) -> None:
    """Run the detectors of the baseline in FOLDER over its own log, or over other LOGS."""
    from mooringdx.baseline import load
    from mooringdx.results import clear, guard, log_names, read_json

    guard(folder, "detect", force)
    baseline = load(folder)
    paths = list(logs) or [Path(os.path.normpath(folder / p)) for p in read_json(folder / "run.json")["logs"]]
    clear(folder, "detect")
    if len(paths) == 1:
        finish([outcome(detect_log(baseline, paths[0], folder, None))], as_json)
        return
    rows = [
        detect_row(baseline, path, folder / "logs" / name) for path, name in zip(paths, log_names(paths), strict=True)
    ]
    write_summary(folder, rows)
    finish(rows, as_json)


@main.command()
@click.argument("folder", type=DIR)
@force_option
def report(folder: Path, force: bool) -> None:
    """Write the document of the detection in FOLDER (of each log in it): report.html and figures."""
    from mooringdx.errors import ReportError
    from mooringdx.results import guard

    guard(folder, "report", force)
    inner = sorted((folder / "logs").glob("*/detection.json")) if (folder / "logs").is_dir() else []
    places = [folder] if (folder / "detection.json").exists() else []
    places += [p.parent for p in inner]
    if not places:
        raise ReportError(f"{folder}: no detection in it; `mooringdx detect {folder}` makes one")
    for place in places:
        click.echo(f"wrote {write_report(place)}")


@main.command()
@click.argument("run_file", type=LOG)
@click.argument("log", type=LOG, required=False)
@out_option
@extrapolate_option
@force_option
@json_option
def run(run_file: Path, log: Path | None, out: Path, extrapolate: bool, force: bool, as_json: bool) -> None:
    """Fit, detect and report on one log."""
    from mooringdx.results import guard

    guard(out, "run", force)
    baseline, channels = fit_logs(run_file, [log] if log else [], out, extrapolate)
    if not as_json:
        click.echo(baseline.text() + "\n")
    path = log or log_path(run_file, baseline.config())
    detection = detect_log(baseline, path, out, channels[0])
    page = write_report(out)
    click.echo(f"report: {page}", err=True)
    finish([outcome(detection)], as_json)


@main.command()
@click.argument("scenario", type=LOG)
@click.option("-o", "--out", type=LOG, required=True, help="The log to write: .csv, .mcap or .parquet.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Same seed, same bytes.")
def simulate(scenario: Path, out: Path, seed: int) -> None:
    """Make a log with a known fault, and its truth beside it."""
    from mooringdx.results import json_bytes, write_files
    from mooringdx.simulate import load_scenario, save_log
    from mooringdx.simulate import simulate as make

    log, truth = make(load_scenario(scenario), seed)
    save_log(log, out)
    write_files(out.parent, {f"{out.name.split('.')[0]}.truth.json": json_bytes(truth)})
    click.echo(f"wrote {out} and its truth")


@main.command()
@click.argument("paper")
@click.option("-o", "--out", type=DIR, help="Folder of the results; reports/PAPER when left out.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Same seed, same bytes.")
def reproduce(paper: str, out: Path | None, seed: int) -> None:
    """Carry a source PAPER out anew: its figures and claims beside what is measured here."""
    from mooringdx.reproduce import run_paper

    click.echo(run_paper(paper, out or Path("reports") / paper, seed))


@main.command()
@click.argument("plan", type=LOG)
@click.option("--data", type=DIR, help="Folder of the labelled logs; a plan's paths are relative to it.")
@out_option
@json_option
def assess(plan: Path, data: Path | None, out: Path, as_json: bool) -> None:
    """Score the detection against labelled logs: rates, delays, isolation, with intervals."""
    from mooringdx.assess import run_plan

    text, result = run_plan(plan, out, data)
    if as_json:
        put_json(result)
    else:
        click.echo(text)


@main.command()
@json_option
def doctor(as_json: bool) -> None:
    """Show versions, and whether the installation is sound."""
    from mooringdx.doctor import examine

    rows = examine()
    if as_json:
        put_json(
            [
                {"part": name, "version": version, "sound": sound, "remedy": remedy}
                for name, version, sound, remedy in rows
            ]
        )
    else:
        table(
            "installation",
            ("part", "version", "sound", "remedy"),
            [(a, b, "yes" if c else "NO", d) for a, b, c, d in rows],
        )
    if not all(row[2] for row in rows):
        sys.exit(FAILED)


def vessel_lines(name: str, out: Path) -> Sequence[str]:
    """Return the lines of the vessel that a run file at ``out`` would name."""
    from mooringdx.config import vessel_file
    from mooringdx.physics.vessel import load_vessel

    return load_vessel(vessel_file(name, out)).mooring.lines


def read(path: Path, config: RunConfig | None) -> RawLog:
    """Read one log with a progress bar on standard error when that is a terminal."""
    from mooringdx.config import CsvOptions, TimeSource
    from mooringdx.logs import read_log

    with progress(f"reading {path.name}") as step:
        if config is None:
            return read_log(path, None, TimeSource(), CsvOptions(), progress=step)
        return read_log(path, config.channels, config.log.time, config.log.csv, progress=step)


def log_path(run_file: Path, config: RunConfig) -> Path:
    """Return the log that a run file names, relative to the file."""
    from mooringdx.errors import ConfigError

    if config.log.path is None:
        raise ConfigError(f"{run_file}: [log] path is missing; give it there, or a LOG on the command line")
    return Path(os.path.normpath(run_file.parent / config.log.path))


def fit_logs(run_file: Path, logs: Sequence[Path], out: Path, extrapolate: bool) -> tuple[Baseline, list[Channels]]:
    """Read, align and fit; write baseline.json and run.json into ``out``."""
    from mooringdx.baseline import save
    from mooringdx.config import load_run
    from mooringdx.pipeline import fit as learn
    from mooringdx.pipeline import prepare
    from mooringdx.results import clear, write_files

    config = load_run(run_file)
    paths = list(logs) or [log_path(run_file, config)]
    channels = [prepare(read(path, config), config) for path in paths]
    with progress("learning the baseline") as step:
        baseline = learn(channels, config, extrapolate=extrapolate, progress=step)
    clear(out, "fit")
    write_files(out, save(baseline, paths, command(), out))
    return baseline, channels


def detect_log(baseline: Baseline, path: Path, target: Path, channels: Channels | None) -> Detection:
    """Detect on one log and write its stages and events into ``target``."""
    from mooringdx.pipeline import detect as find
    from mooringdx.pipeline import prepare
    from mooringdx.report import as_json, events_csv
    from mooringdx.results import detection_files, json_bytes, write_files

    config = baseline.config()
    ready = channels if channels is not None else prepare(read(path, config), config)
    detection = find(ready, baseline, name=path.name, command=command())
    files = detection_files(detection)
    files["events.json"] = json_bytes(as_json(detection))
    files["events.csv"] = events_csv(detection).encode()
    write_files(target, files)
    return detection


def command() -> str:
    """Return the command line as it was given, for the provenance."""
    return " ".join(["mooringdx", *sys.argv[1:]])


def write_report(folder: Path) -> Path:
    """Write report.html and figures/ of the detection stored in ``folder``."""
    from mooringdx.errors import ReportError
    from mooringdx.report import write
    from mooringdx.results import load_detection, read_json

    detection = load_detection(folder)
    fitted = folder if (folder / "run.json").exists() else folder.parent.parent
    if read_json(fitted / "run.json")["configuration_digest"] != detection.provenance["configuration_digest"]:
        raise ReportError(f"{folder}: detected with another configuration than {fitted / 'run.json'}; detect again")
    return write(detection, folder)


def outcome(detection: Detection) -> dict[str, Any]:
    """Return what the end of a command needs of one detection: its contract and its text, not its arrays."""
    from mooringdx.report import as_json as contract
    from mooringdx.report import summary_row, text

    return {"json": contract(detection), "text": text(detection), "row": summary_row(detection)}


def detect_row(baseline: Baseline, path: Path, target: Path) -> dict[str, Any]:
    """Detect on one of several logs; a log that cannot be read is a row with its reason, and the batch goes on."""
    try:
        return outcome(detect_log(baseline, path, target, None))
    except MooringdxError as error:
        row = {"name": path.name, "verdict": "failed", "cannot_tell": str(error)}
        return {
            "json": {"name": path.name, "verdict": "failed", "error": str(error)},
            "text": f"{path.name}: failed: {error}",
            "row": row,
        }


def write_summary(folder: Path, found: Sequence[dict[str, Any]]) -> None:
    """Write summary.csv: one row a log."""
    from mooringdx.report import summary_csv
    from mooringdx.results import write_files

    write_files(folder, {"summary.csv": summary_csv([f["row"] for f in found]).encode()})


def finish(found: Sequence[dict[str, Any]], as_json: bool) -> None:
    """Print the outcome and leave with the status that a script can rely on."""
    bodies = [f["json"] for f in found]
    if as_json:
        put_json(bodies[0] if len(found) == 1 else bodies)
    else:
        click.echo("\n\n".join(f["text"] for f in found))
    verdicts = {body["verdict"] for body in bodies}
    if "failed" in verdicts:
        sys.exit(WRONG)
    if "fault_found" in verdicts:
        sys.exit(FOUND)


def put_json(body: Any) -> None:
    """Print JSON on standard output and nothing else."""
    from mooringdx.results import json_bytes

    sys.stdout.write(json_bytes(body).decode())


def survey_cells(row: dict[str, Any]) -> tuple[str, ...]:
    """Return one survey row as the terminal table shows it."""

    def number(value: float | None, digits: int = 4) -> str:
        return "" if value is None else f"{value:.{digits}g}"

    return (
        str(row["signal"]),
        str(row["unit"] or ""),
        f"{number(row['rate'])} Hz" if row["rate"] else "",
        f"{number(row['span'], 6)} s",
        str(row["samples"]),
        f"{row['gaps']} (<= {number(row['longest_gap'], 3)} s)" if row["gaps"] else "0",
        f"{row['stuck']} (<= {number(row['longest_stuck'], 3)} s)" if row["stuck"] else "0",
        number(row["min"]),
        number(row["median"]),
        number(row["max"]),
        str(row["guess"] or ""),
    )


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table to standard output."""
    from rich.console import Console
    from rich.table import Table

    body = Table(title=title, title_justify="left")
    for name in header:
        body.add_column(name, overflow="fold")
    for row in rows:
        body.add_row(*row)
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(body)


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None] | None]:
    """Yield a callback (done, total) that moves a bar on standard error; None when that is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
