"""Self-contained HTML pages: Jinja templates with embedded images."""

import base64
from importlib.resources import files
from typing import Any, NamedTuple

import jinja2

from skystack.reporting.style import with_dark_colours


class Picture(NamedTuple):
    """An embedded image and its alternative text."""

    source: str
    """A data URL, so that the page needs no other file."""
    words: str


def picture_of(drawing: str, words: str) -> Picture:
    """Embed an SVG drawing; its colours follow the page's light or dark theme."""
    data = base64.b64encode(with_dark_colours(drawing).encode()).decode()
    return Picture(f"data:image/svg+xml;base64,{data}", words)


def render(template: str, **values: Any) -> bytes:
    """Render a template of this package; all values are escaped as HTML."""
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(template_source),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values).encode()


def template_source(template: str) -> str:
    """The text of a template of this package."""
    return files("skystack.reporting").joinpath(template).read_text("utf-8")
