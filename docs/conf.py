"""The documentation as a site: `python3 dev.py docs` builds it, without a network."""

from typing import Any

import skystack

project = "skystack"
author = "the skystack developers"
copyright = "2026, the skystack developers"
release = version = skystack.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
myst_heading_anchors = 3
"""Headings can be linked to, as on any forge that shows Markdown."""

html_theme = "furo"
html_title = "skystack"
html_show_sourcelink = False
html_copy_source = False
exclude_patterns = ["_build"]

default_role = "code"
"""What stands in single backticks in docstrings is code there as in Markdown."""
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True}


def setup(app: Any) -> None:
    app.connect("autodoc-process-docstring", show_indented_as_code)


def show_indented_as_code(
    app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """An indented block is shown as it stands, as in Markdown; else it would be a quotation."""
    shown: list[str] = []
    for line in lines:
        before = next((each for each in reversed(shown) if each), "")
        begins = line.startswith("    ") and not before.startswith((" ", ".."))
        if begins and shown and not shown[-1]:
            shown += ["::", ""]
        shown.append(line)
    lines[:] = shown
