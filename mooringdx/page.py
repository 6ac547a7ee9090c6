"""A self-contained HTML page from one of the package's templates."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from typing import Any


def render(template: str, context: Mapping[str, Any]) -> str:
    """Return ``template`` (a file in templates/) filled with ``context``; an unknown name in it is an error."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    templates = files("mooringdx") / "templates"
    environment = Environment(
        loader=FunctionLoader(lambda name: (templates / name).read_text(encoding="utf-8")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(context)
