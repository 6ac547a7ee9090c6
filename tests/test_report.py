"""The report: words, data and page agree with the detection they were made from."""

from __future__ import annotations

import base64
import csv
import io
import json
import re
import subprocess
import sys
import time
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path

import detections
import jsonschema
import pytest

from mooringdx import report
from mooringdx.report import wording
from mooringdx.types import replace

SCHEMA = json.loads((files("mooringdx") / "schemas" / "events.schema.json").read_text())
VOID = {"meta", "img", "br", "link", "hr"}


class Page(HTMLParser):
    """Collect text, links and sources; check that every element is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.targets: list[str] = []
        self.ids: list[str] = []
        self.words = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        for key, value in attrs:
            if key in ("src", "data"):
                self.sources.append(value or "")
            if key == "href":
                self.targets.append(value or "")
            if key == "id":
                self.ids.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words += data + " "


@pytest.fixture(scope="module", params=["line_lost", "dirty", "adrift", "cannot_be_judged"])
def rendered(request: pytest.FixtureRequest) -> tuple[str, dict[str, bytes]]:
    return request.param, report.render(detections.ALL[request.param]())


def test_page_is_self_contained(rendered: tuple[str, dict[str, bytes]]) -> None:
    """Truth: the parser. Every source is a data URI, every link a section that exists; under 6 MB."""
    text = rendered[1]["report.html"].decode()
    page = Page(text)
    assert len(text) < 6_000_000
    assert page.sources
    assert all(s.startswith("data:image/") for s in page.sources)
    assert all(t.startswith("#") and t[1:] in page.ids for t in page.targets)
    assert len(page.ids) == len(set(page.ids))
    assert not re.search(r"url\(|@import|https?://", re.sub(r"data:[^\"]*", "", text))


def test_pictures_are_files_too(rendered: tuple[str, dict[str, bytes]]) -> None:
    """Truth: the page's own images. Each is one of the files, which come in pairs."""
    _, body = rendered
    stems = {name.rsplit(".", 1)[0] for name in body if name.startswith("figures/")}
    assert {f"{s}.{e}" for s in stems for e in ("png", "svg")} == {n for n in body if n.startswith("figures/")}
    drawn = [base64.b64decode(s.split(",", 1)[1]) for s in Page(body["report.html"].decode()).sources]
    assert len(drawn) == len(stems)
    assert all(picture in body.values() for picture in drawn)


def test_page_says_what_the_signer_needs(rendered: tuple[str, dict[str, bytes]]) -> None:
    case, body = rendered
    detection = detections.ALL[case]()
    words = " ".join(Page(body["report.html"].decode()).words.split())
    made = detection.provenance
    for needed in (detection.name, detection.channels.source.sha256, made["configuration_digest"], made["command"]):
        assert needed in words
    for event in detection.events:
        assert wording.what(event)[1:] in words  # a sentence may start with it
        for rival in event.rivals:
            assert rival.why_not in words
        if event.cannot_tell:
            assert event.cannot_tell in words
    assert words.index("Before you sign") < words.index("What was analysed") if "NO" in words else True
    for check in detection.checks:
        assert check.remedy in words


def test_failed_checks_come_first() -> None:
    from mooringdx.report.document import context

    passed = [c.passed for c in context(detections.sensor_fault(), ())["checks"]]
    assert passed == sorted(passed)
    assert passed[0] is False


def test_extrapolated_is_said_loudly() -> None:
    """Truth: construction. The extrapolated level shows in text, page, table and figure caption."""
    from mooringdx.plots import FIGURES
    from mooringdx.report.document import page

    detection = detections.sensor_fault()
    said = page(detection, ())
    assert "EXTRAPOLATED" in report.text(detection)
    assert said.count("EXTRAPOLATED") >= 4
    assert "EXTRAPOLATED" in FIGURES["statistic"].caption(detection, "main")
    assert "EXTRAPOLATED" not in page(detections.line_lost(), ())


def test_hostile_names_are_escaped(tmp_path: Path) -> None:
    from mooringdx.report.document import page

    detection = replace(detections.dirty(), name="<script>alert(1)</script>")
    assert "<script>alert" not in page(detection, ())


@pytest.mark.parametrize("case", list(detections.ALL))
def test_events_json_fits_its_schema(case: str) -> None:
    """Truth: the published schema."""
    body = report.as_json(detections.ALL[case]())
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.validate(json.loads(json.dumps(body, allow_nan=False)), SCHEMA)


def test_schema_refuses_what_is_wrong() -> None:
    body = report.as_json(detections.line_lost())
    for spoil in ({"verdict": "maybe"}, {"extra": 1}, {"events": [{**body["events"][0], "kind": "broken"}]}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**body, **spoil}, SCHEMA)


def test_json_and_csv_tell_the_same() -> None:
    """Truth: the detection."""
    detection = detections.sensor_fault()
    event = detection.events[0]
    body = report.as_json(detection)["events"][0]
    rows = list(csv.DictReader(io.StringIO(report.events_csv(detection))))
    assert [r["id"] for r in rows] == ["event_1", "event_2"]
    assert float(rows[0]["onset"]) == body["onset"] == event.onset
    assert [float(rows[0]["size_low"]), float(rows[0]["size_high"])] == body["size"]["interval"]
    assert rows[0]["rivals"] == "line_weakened line_3 0.28"
    assert rows[0]["marks"] == "extrapolated_threshold"
    assert rows[0]["onset_iso"] == ""
    assert body["onset_iso"] is None


def test_instants_of_an_epoch_log() -> None:
    """Truth: the calendar. 300 days after 1986-03-07T12:00Z is 1987-01-01T12:00Z."""
    event = report.as_json(detections.adrift())["events"][0]
    assert event["onset_iso"] == "1987-01-01T12:00:00.000Z"
    assert event["onset_interval_iso"][0] == "1986-12-31T12:00:00.000Z"
    assert event["cleared_iso"] is None
    assert wording.iso(0.9996, 0) == "1970-01-01T00:00:01.000Z"
    assert wording.iso(-1.5, 0) == "1969-12-31T23:59:58.500Z"


def test_rates_in_words() -> None:
    """Truth: the sentence that the method asks for."""
    said = wording.rates(detections.rate("supported"))
    assert said.startswith("1 per 30 days asked; this record supports 1 per 3 days to 1 per 10 years")
    assert wording.rates({}) == ""
    assert "an unknown rate" in wording.rates({"asked": 1.0, "interval": (float("nan"), 1.0), "verdict": "invalid"})


@pytest.mark.parametrize("case", list(detections.ALL))
def test_terminal_text_is_short_and_leads_with_the_verdict(case: str) -> None:
    detection = detections.ALL[case]()
    lines = report.text(detection).splitlines()
    assert 1 <= len(lines) <= 10
    assert lines[0].startswith(f"{detection.name}: {wording.VERDICT[detection.verdict]}")


def test_summary_has_one_row_a_log() -> None:
    rows = list(
        csv.DictReader(
            io.StringIO(report.summary_csv([report.summary_row(build()) for build in detections.ALL.values()]))
        )
    )
    assert [r["verdict"] for r in rows].count("fault_found") == 5
    assert rows[0]["subject"] == "line_4"
    assert rows[2]["kind"] == ""


def test_write_replaces_its_own_figures_only(tmp_path: Path) -> None:
    """Truth: the folder, before and after."""
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "event_9.png").write_bytes(b"old")
    (tmp_path / "figures" / "notes.txt").write_text("mine")
    page = report.write(detections.adrift(), tmp_path)
    first = {p.name: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    assert page == tmp_path / "report.html"
    assert "event_9.png" not in first
    assert first["notes.txt"] == b"mine"
    report.write(detections.adrift(), tmp_path)
    assert first == {p.name: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}


def test_data_need_no_drawing_library() -> None:
    """Truth: the interpreter's own list of modules."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import detections; from mooringdx import report;"
        "d = detections.adrift(); report.as_json(d); report.events_csv(d); report.text(d);"
        "assert not {'matplotlib', 'jinja2'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code, str(Path(detections.__file__).parent)], check=True)


@pytest.mark.slow
def test_a_day_at_ten_hertz_in_thirty_seconds() -> None:
    """Truth: the processor's clock (the wall's where the machine is busy with other work)."""
    detection = detections.line_lost(864_000)
    report.render(detections.adrift())
    start = time.process_time()
    body = report.render(detection)
    assert time.process_time() - start < 30.0
    assert len(body["report.html"]) < 6_000_000
