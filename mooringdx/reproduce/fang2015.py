"""The experiment of [Fang2015, sections 2.2-3.2] on a simulated twin: figures 3 to 8, and each claim beside a number.

configs/scenarios/fang_paper.toml is the experiment (waves from 150 s, the current growing from 370 to 520 s, the buoy
of line 4 lost at 580 s), configs/runs/fang2015.toml the method (fitted on [180, 550] s). The record is simulated,
written as a log, and read back: what is shown is what the commands `simulate` and `run` would give.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from mooringdx.errors import ConfigError, ReportError
from mooringdx.reproduce.claims import claims, text
from mooringdx.reproduce.study import Repeat, Study, analyse, repeat
from mooringdx.types import RawLog, replace

NAME = "fang2015"
FURTHER = 7
"""Records beside the one that is drawn."""
OWN = (
    "index.html", "figures", "claims.json", "log.csv", "log.truth.json", "run.json", "baseline.json", "detection.json",
    "stages.parquet",
)  # fmt: skip


def reproduce(out: Path, seed: int) -> str:
    """Write the whole reproduction into ``out``; see the module. Return the claims in words, a line each."""
    from mooringdx.reproduce.page import pages
    from mooringdx.results import write_files

    _refuse_strangers(out)
    scenario, run_file = setting("scenarios", "fang_paper"), setting("runs", NAME)
    study, files = experiment(scenario, run_file, seed)
    found = claims(study, again(scenario, study, range(seed + 1, seed + 1 + FURTHER)))
    files |= pages(study, found, command(seed))
    write_files(out, files)
    for old in sorted((out / "figures").glob("*")):
        if f"figures/{old.name}" not in files:
            old.unlink()
    return text(found)


def command(seed: int) -> str:
    """Return the command that makes the page again."""
    return f"mooringdx reproduce {NAME} -o DIR --seed {seed}"


def setting(kind: str, name: str) -> Path:
    """Return a file of configs, "runs" or "scenarios"; ConfigError where the installation lacks it."""
    from mooringdx.config import VESSELS

    places = [folder.parent / kind / f"{name}.toml" for folder in VESSELS]
    for place in places:
        if place.is_file():
            return place
    raise ConfigError(f"no {kind[:-1]} file {places[0]}; run from a checkout of mooringdx, which holds it")


def experiment(scenario: Path, run_file: Path, seed: int) -> tuple[Study, dict[str, Any]]:
    """Return the study of one simulated record, and the files that a `simulate` and a `run` of it would leave."""
    from mooringdx.baseline import save
    from mooringdx.config import load_run
    from mooringdx.pipeline import detect, fit, prepare
    from mooringdx.results import detection_files, json_bytes
    from mooringdx.simulate import load_scenario, simulate

    config = load_run(run_file)
    log, truth = simulate(load_scenario(scenario), seed)
    raw, body = _logged(log, config)
    channels = prepare(raw, config)
    baseline = fit([channels], config, extrapolate=True)
    detection = detect(channels, baseline, name="log.csv", command=command(seed))
    fault = truth["faults"][0]
    files: dict[str, Any] = {
        "log.csv": body,
        "log.truth.json": json_bytes(truth),
        **save(baseline, [Path("log.csv")], command(seed)),
    }
    files |= detection_files(detection)
    return analyse(baseline, detection, float(fault["onset"]), str(fault["subject"])), files


def again(scenario: Path, study: Study, seeds: Iterable[int]) -> tuple[Repeat, ...]:
    """Return the outcome on one further record a seed, each with its own sea, rig and fit."""
    from mooringdx.pipeline import prepare
    from mooringdx.simulate import load_scenario, simulate

    run, plan = study.baseline.config(), load_scenario(scenario)
    logs = ((seed, prepare(simulate(plan, seed)[0], run)) for seed in seeds)
    return tuple(repeat(channels, run, study, seed) for seed, channels in logs)


def _logged(log: RawLog, config: Any) -> tuple[RawLog, bytes]:
    """Return the simulated log as it reads back from a CSV file, and the file's bytes."""
    from tempfile import TemporaryDirectory

    from mooringdx.logs import read_log
    from mooringdx.simulate import save_log

    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        save_log(log, path)
        raw = read_log(path, config.channels, config.log.time, config.log.csv)
        return replace(raw, source=replace(raw.source, path=path.name)), path.read_bytes()


def _refuse_strangers(out: Path) -> None:
    if out.is_file():
        raise ReportError(f"{out}: is a file, not a folder; give another -o DIR")
    for item in sorted(out.iterdir()) if out.exists() else []:
        if item.name not in OWN and not item.name.startswith("."):
            raise ReportError(f"{out}: holds '{item.name}', which reproduce did not write; give another -o DIR")
