"""The documentation as a site: `python3 dev.py docs` builds it, without a network."""

from importlib.util import find_spec
from typing import Any

from docutils import nodes  # type: ignore[import-untyped]
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform

import skystack

project = "skystack"
author = "the skystack developers"
copyright = "2026, the skystack developers"
release = version = skystack.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
myst_heading_anchors = 3
"""Headings can be linked to, as on any forge that shows Markdown."""

smartquotes_action = "qe"
"""Quotes and ellipses only: `--` begins an option."""

html_theme = "furo"
html_title = "skystack"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False
"""Summaries are read from the pages, which browsers refuse when a site is opened from a file."""
exclude_patterns = ["_build"]

default_role = "code"
"""What stands in single backticks in docstrings is code there as in Markdown."""
autodoc_mock_imports = [
    name for name in ("pettingzoo", "stable_baselines3") if find_spec(name) is None
]
"""The site can be built without the packages of extras."""
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True}
autodoc_preserve_defaults = True
maximum_signature_line_length = 100
toc_object_entries_show_parents = "hide"

LONGEST_ON_ONE_LINE = 24
"""Table cells with at most this number of characters, such as numbers, are never broken."""


def setup(app: Sphinx) -> None:
    app.connect("autodoc-process-docstring", remove_generated_field_texts)
    app.connect("autodoc-process-docstring", show_indented_as_code)
    app.connect("autodoc-skip-member", skip_top_level)
    app.connect("doctree-read", link_full_names)
    app.add_post_transform(CellClasses)


def show_indented_as_code(
    app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """An indented block is shown as it stands, as in Markdown; else it would be a quotation."""
    shown: list[str] = []
    for line in lines:
        before = next((each for each in reversed(shown) if each), "")
        begins = line.startswith("    ") and not before.startswith((" ", ".."))
        if begins and shown and not shown[-1]:
            shown += ["::" if line.lstrip().startswith(">>>") else ".. code-block:: text", ""]
        shown.append(line)
    lines[:] = shown


def remove_generated_field_texts(
    app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """Python's own texts for the fields of a NamedTuple ("Alias for field number 0") say nothing.

    A field without a text is only in the signature of its class, as in other classes.
    """
    for field in getattr(obj, "_fields", ()) if isinstance(obj, type) else ():
        described: Any = getattr(obj, field)
        if (described.__doc__ or "").startswith("Alias for field number"):
            described.__doc__ = ""


TOP_LEVEL = {
    id(getattr(skystack, name)): name for name in skystack.__all__ if not name.startswith("_")
}


def skip_top_level(
    app: Any, what: str, name: str, obj: Any, skip: bool, options: Any
) -> bool | None:
    """What `skystack` itself offers is on the page API only: each object has one entry."""
    return True if TOP_LEVEL.get(id(obj)) == name else None


def link_full_names(app: Any, document: nodes.document) -> None:
    """Types link to the objects of their full names, never to others with the same last name."""
    for reference in document.findall(pending_xref):
        reference.attributes.pop("refspecific", None)


class CellClasses(SphinxPostTransform):
    """Mark the cells of tables as `short` or `long`, for `static/site.css`."""

    default_priority = 500

    def run(self, **_: Any) -> None:
        for cell in self.document.findall(nodes.entry):
            short = len(cell.astext()) <= LONGEST_ON_ONE_LINE
            cell["classes"].append("short" if short else "long")
