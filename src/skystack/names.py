"""Names that become parts of paths: one rule, whatever file or argument they come from.

Names of experiments, trainings and platforms become folders and files. A policy or a run folder may
come from anybody, so its names are checked when they are read.
"""

import re
from typing import Annotated

import msgspec

from skystack.errors import InputError

MOST_NAME = 80
"""Characters: with a seed, a platform and an ending it is still no longer than a file's may be."""
_PATTERN = rf"^[A-Za-z0-9_][A-Za-z0-9._-]{{0,{MOST_NAME - 1}}}\Z"
# ASCII alone: file systems differ in how they write and compare all other letters.
_ALLOWED = f"1 to {MOST_NAME} of A-Z, a-z, 0-9, '.', '_' and '-', the first not '.' or '-'"

Name = Annotated[str, msgspec.Meta(pattern=_PATTERN)]
"""In a structure that is read from a file: the name of a single file or folder, nothing else."""
Seed = Annotated[int, msgspec.Meta(ge=0, le=2**31 - 1)]
"""It follows a name in the name of a folder; as large as one on the command line."""


def check_name(what: str, text: str) -> str:
    """The text, if it may name a file or a folder. Raises InputError that says what it is of."""
    if re.search(_PATTERN, text) is None:
        raise InputError(f"{what} is {text!r} (allowed: {_ALLOWED})")
    return text


def as_name(text: str) -> str:
    """A name made of any text, which stays as it is where it is one already."""
    safe = re.sub(r"[^A-Za-z0-9._-]+", "-", text).lstrip(".-")[:MOST_NAME].rstrip(".-")
    return text if re.search(_PATTERN, text) else safe or "policy"


def in_words(message: str) -> str:
    """A message of msgspec with the rule for names in words, in place of its pattern."""
    return message.replace(f"`str` matching regex {_PATTERN!r}", _ALLOWED)
