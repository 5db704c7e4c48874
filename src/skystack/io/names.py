"""Names that become parts of paths: one rule for all files and arguments.

Names of experiments, training runs and platforms become names of folders and files. Policies and
run folders are untrusted, so the names in them are checked when they are read.
"""

import re
from typing import Annotated

import msgspec

from skystack.errors import MAX_INT, InputError

MAX_NAME_CHARS = 80
"""The maximum length: leaves room in a file name for a seed, a platform and a suffix."""
_PATTERN = rf"^[A-Za-z0-9_][A-Za-z0-9._-]{{0,{MAX_NAME_CHARS - 1}}}\Z"
# ASCII only: file systems differ in how they encode and compare other letters.
_ALLOWED = f"1 to {MAX_NAME_CHARS} of A-Z, a-z, 0-9, '.', '_' and '-', the first not '.' or '-'"

Name = Annotated[str, msgspec.Meta(pattern=_PATTERN, description=_ALLOWED)]
"""The type of a field that must be valid as the name of one file or folder."""
Seed = Annotated[int, msgspec.Meta(ge=0, le=MAX_INT)]
"""The type of a seed, which becomes part of a folder name; same range as on the command line."""


def check_name(what: str, text: str) -> str:
    """Return the text if it is a valid file name. Raises InputError, which calls it `what`."""
    if re.search(_PATTERN, text) is None:
        raise InputError(f"{what} is {text!r} (allowed: {_ALLOWED})")
    return text


def as_name(text: str) -> str:
    """A valid name made from any text; a text that is already valid is unchanged."""
    safe = re.sub(r"[^A-Za-z0-9._-]+", "-", text).lstrip(".-")[:MAX_NAME_CHARS].rstrip(".-")
    return text if re.search(_PATTERN, text) else safe or "policy"
