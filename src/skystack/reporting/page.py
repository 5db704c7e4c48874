"""Pages that need no other file: templates filled in, drawings inside."""

import base64
from importlib.resources import files
from typing import Any, NamedTuple

import jinja2

from skystack.reporting.style import follow_the_page


class Picture(NamedTuple):
    """An image inside the page, and what it shows in words."""

    source: str
    """A data address: the page needs no other file."""
    words: str


def picture_of(drawing: str, words: str) -> Picture:
    """An SVG drawing as a picture that follows the page's colours."""
    data = base64.b64encode(follow_the_page(drawing).encode()).decode()
    return Picture(f"data:image/svg+xml;base64,{data}", words)


def render(template: str, **values: Any) -> bytes:
    """A page from a template of this package; every text in it is escaped."""
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_source),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values).encode()


def _source(template: str) -> str:
    return files("skystack.reporting").joinpath(template).read_text("utf-8")
