"""The house keeps its own rules: those of CONTRIBUTING.md, checked against the files themselves."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

from mooringdx.config import AdriftPart, RunConfig, load_run
from mooringdx.physics.vessel import VesselModel
from mooringdx.simulate import Scenario

ROOT = Path(__file__).parents[1]
MODULES = sorted((ROOT / "mooringdx").rglob("*.py"))
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "data").glob("*.md")])
CITATION = re.compile(r"\[([A-Z][A-Za-z]+(?:\d{4}|Thesis)[^\[\]]*)\]")
KEY = re.compile(r"\b[A-Z][A-Za-z]+(?:\d{4}|Thesis)\b")
# A folder's table, and the modules in the folder that no entry of the table lives in: what the entries share.
TABLES = {
    ("residuals", "GENERATORS"): {"statics", "training"},
    ("detectors", "DETECTORS"): {"covariance", "design", "reference", "window"},
    ("plots", "FIGURES"): {"canvas", "suspects", "survey"},
}


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def public(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.ClassDef]:
    """Yield public functions and classes, and the public methods of public classes."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef) and not any(getattr(b, "id", "") == "Protocol" for b in node.bases):
                yield from (n for n in node.body if isinstance(n, ast.FunctionDef) and not n.name.startswith("_"))


def known_keys() -> set[str]:
    return set(
        re.findall(r"^- \*\*([A-Za-z]+(?:\d{4}|Thesis))\*\*", (ROOT / "REFERENCES.md").read_text(), re.MULTILINE)
    )


@pytest.mark.parametrize("path", [*MODULES, *DOCUMENTS], ids=name)
def test_every_reference_key_resolves(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    cited = {key for citation in CITATION.findall(text) for key in KEY.findall(citation)}
    assert cited <= known_keys(), "add the missing key to REFERENCES.md"


@pytest.mark.parametrize("path", MODULES, ids=name)
def test_everything_public_has_a_docstring(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    bare = [node.name for node in public(tree) if not ast.get_docstring(node)]
    assert ast.get_docstring(tree), "the module has no docstring"
    assert bare == []


@pytest.mark.parametrize("path", MODULES, ids=name)
def test_only_the_edge_catches_everything_and_prints(path: Path) -> None:
    if path.name == "cli.py":
        return
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"except (Base)?Exception\b|except:", text)
    assert not re.search(r"^\s*print\(", text, re.MULTILINE)


@pytest.mark.parametrize(("folder", "table"), TABLES, ids=lambda part: str(part))
def test_modules_and_registry_are_the_same(folder: str, table: str) -> None:
    room = importlib.import_module(f"mooringdx.{folder}")
    registered = {origin(entry) for entry in getattr(room, table).values()}
    modules = {path.stem for path in (ROOT / "mooringdx" / folder).glob("*.py")} - {"__init__"}
    assert registered == modules - TABLES[folder, table]


def origin(entry: object) -> str:
    """Return the module, within its folder, that an entry of a table lives in."""
    home = entry if hasattr(entry, "__module__") and callable(entry) else getattr(entry, "draw", entry)
    return str(getattr(home, "__module__", "")).rsplit(".", 1)[-1]


@pytest.mark.parametrize("path", sorted((ROOT / "configs" / "runs").glob("*.toml")), ids=name)
def test_every_run_file_loads(path: Path) -> None:
    assert load_run(path).channels


def tracked() -> list[Path]:
    done = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if done.returncode != 0:
        pytest.skip("not a git checkout: what is tracked cannot be listed")
    paths = [ROOT / part for part in done.stdout.decode().split("\0") if part]
    return [path for path in paths if path.is_file()]


def test_no_registry_host_and_no_path_of_one_machine_is_tracked() -> None:
    hosts = "|".join(["py" + r"pi\.org", "python" + r"hosted\.org", "npm" + r"js\.(com|org)", r"debian\.(org|com)"])
    places = "|".join(f"/{top}/" for top in ("work", "tmp", "root", "home"))
    found = re.compile(rf"https?://[a-z.]*({hosts})|--(extra-)?index-url\b(?=[ =]\S+:)|(?<![\w.~}}*$-])({places})\w")
    wrong = []
    for path in tracked():
        text = path.read_bytes().decode("utf-8", errors="replace")
        wrong += [f"{name(path)}: {hit[0]}" for hit in found.finditer(text)]
    assert wrong == []


def commands() -> set[str]:
    from mooringdx.cli import main

    return set(main.commands)


def test_readme_commands_exist_and_every_command_is_in_the_readme() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    told = set(re.findall(r"^mooringdx ([a-z]+)\b|`mooringdx ([a-z]+)\b", text, re.MULTILINE))
    assert {first or second for first, second in told} == commands()


def test_readme_targets_exist() -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for path in DOCUMENTS:
        assert set(re.findall(r"`make ([a-z]+)`|^make ([a-z]+)", path.read_text(), re.MULTILINE)) <= {
            pair for target in targets for pair in ((target, ""), ("", target))
        }, name(path)


def keys(model: type[BaseModel]) -> Iterator[str]:
    """Yield every key of a run file, down to the leaves; the page of the adrift bank explains its own."""
    for key, field in model.model_fields.items():
        yield key
        stack = [field.annotation]
        while stack:
            kind = stack.pop()
            stack += list(getattr(kind, "__args__", ()))
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from keys(kind) if kind is not AdriftPart else ()


@pytest.mark.parametrize("key", sorted(set(keys(RunConfig))))
def test_the_readme_explains_every_key_of_a_run_file(key: str) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8").split("## The run file")[1].split("\n## ")[0]
    spans = [*re.findall(r"`([^`\n]*)`", text), *re.findall(r"\*\*(\[[^\]]*\])\*\*", text)]
    assert any(re.search(rf"\b{key}\b", span) for span in spans)


def test_links_between_documents_resolve() -> None:
    for path in DOCUMENTS:
        for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", path.read_text(encoding="utf-8")):
            assert (path.parent / target).exists(), f"{name(path)} links to {target}"


def leaves(model: type[BaseModel]) -> Iterator[str]:
    """Yield every key of a vessel or scenario file, down to the leaves; a vessel's content in a scenario is its own."""
    for key, field in model.model_fields.items():
        yield key
        stack = [field.annotation]
        while stack:
            kind = stack.pop()
            stack += list(getattr(kind, "__args__", ()))
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from leaves(kind)


@pytest.mark.parametrize(("heading", "model"), [("Vessel file", VesselModel), ("Scenario file", Scenario)])
def test_the_page_on_vessels_explains_every_key_of_its_files(heading: str, model: type[BaseModel]) -> None:
    text = (ROOT / "docs" / "vessel.md").read_text(encoding="utf-8").split(f"\n## {heading}")[1].split("\n## ")[0]
    spans = [*re.findall(r"`([^`\n]*)`", text), *re.findall(r"\*\*(\[[^*]*\])\*\*", text)]
    missing = [key for key in sorted(set(leaves(model))) if not any(re.search(rf"\b{key}\b", s) for s in spans)]
    assert missing == []
