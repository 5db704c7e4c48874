"""Names that become parts of paths: one rule, whichever file or argument they come from.

Names of experiments, trainings and platforms become folders and files. A policy or a run folder may
come from anybody, so its names are checked when they are read.
"""

import re
from typing import Annotated

import msgspec

from skystack.errors import MOST_NUMBER, InputError

MOST_NAME = 80
"""Characters: short enough for a file name even with a seed, a platform and a suffix added."""
_PATTERN = rf"^[A-Za-z0-9_][A-Za-z0-9._-]{{0,{MOST_NAME - 1}}}\Z"
# ASCII only: file systems differ in how they write and compare all other letters.
_ALLOWED = f"1 to {MOST_NAME} of A-Z, a-z, 0-9, '.', '_' and '-', the first not '.' or '-'"

Name = Annotated[str, msgspec.Meta(pattern=_PATTERN)]
"""A field of a decoded file that must be valid as the name of one file or folder."""
Seed = Annotated[int, msgspec.Meta(ge=0, le=MOST_NUMBER)]
"""A seed becomes part of a folder name; the same range as on the command line."""


def check_name(what: str, text: str) -> str:
    """The text, if it may name a file or a folder. Raises InputError naming what it belongs to."""
    if re.search(_PATTERN, text) is None:
        raise InputError(f"{what} is {text!r} (allowed: {_ALLOWED})")
    return text


def as_name(text: str) -> str:
    """A valid name made from any text; a text that is already valid is unchanged."""
    safe = re.sub(r"[^A-Za-z0-9._-]+", "-", text).lstrip(".-")[:MOST_NAME].rstrip(".-")
    return text if re.search(_PATTERN, text) else safe or "policy"


def in_words(message: str) -> str:
    """A msgspec message with its pattern for names replaced by the rule in words."""
    return message.replace(f"`str` matching regex {_PATTERN!r}", _ALLOWED)
