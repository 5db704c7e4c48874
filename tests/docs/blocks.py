"""The code on a documentation page: fenced blocks with a language, and commands."""

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]

_FENCE = re.compile(r"^```(?P<language>\w+)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE)
_COMMAND = re.compile(r"^    (?P<text>(?:skystack|python3?|pip) (?:.*\\\n)*.*)$", re.MULTILINE)
_CONTINUED = re.compile(r"\\\n\s*")
_INLINE = re.compile(r"`(?P<text>skystack [^`]+)`")


class Block(NamedTuple):
    """A piece of code on a page."""

    start: int
    """Its position on the page."""
    language: str
    """`python`, `toml`, `json`; `command` for a shell command, whose lines are joined; `inline` for
    one in a sentence."""
    text: str


def blocks(page: Path) -> list[Block]:
    """All blocks of a page, in order."""
    text = page.read_text()
    found = [Block(m.start(), m["language"], m["text"]) for m in _FENCE.finditer(text)]
    found += [
        Block(m.start(), "command", _CONTINUED.sub("", m["text"])) for m in _COMMAND.finditer(text)
    ]
    found += [Block(m.start(), "inline", m["text"]) for m in _INLINE.finditer(text)]
    return sorted(found)


def anchors(page: Path) -> set[str]:
    """The anchors that forges generate for the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
    cleaned = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {each.replace(" ", "-") for each in cleaned}
