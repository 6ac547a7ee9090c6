"""A `Detection` as a document, and the same numbers as JSON, CSV and text.

Importing this costs no drawing library: figures are drawn only by `render`, `html` and `write`.
"""

from __future__ import annotations

from pathlib import Path

from mooringdx.report.record import as_json, events_csv, summary_csv, summary_row, text
from mooringdx.types import Detection

__all__ = ["as_json", "events_csv", "html", "render", "summary_csv", "summary_row", "text", "write"]


def render(detection: Detection) -> dict[str, bytes]:
    """Return the report as {relative name: bytes}: report.html and each figure as PNG and SVG.

    The same input gives the same bytes.
    """
    from mooringdx.report.document import page, pictures

    drawn = pictures(detection)
    out = {"report.html": page(detection, drawn).encode()}
    for picture in drawn:
        out[f"figures/{picture.name}.png"] = picture.png
        out[f"figures/{picture.name}.svg"] = picture.svg
    return out


def html(detection: Detection) -> str:
    """Return the report as one self-contained HTML page."""
    from mooringdx.report.document import page, pictures

    return page(detection, pictures(detection))


def write(detection: Detection, folder: Path) -> Path:
    """Write report.html and figures/ below ``folder``, remove figures of an earlier report, return the page's path."""
    from mooringdx.results import write_files

    body = render(detection)
    write_files(folder, body)
    for old in sorted((folder / "figures").glob("*")):
        if old.suffix in (".png", ".svg") and f"figures/{old.name}" not in body:
            old.unlink()
    return folder / "report.html"
