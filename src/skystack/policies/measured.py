"""What was measured of a policy, written beside it: `measured.json`."""

import json
from pathlib import Path
from typing import Any

import msgspec

from skystack.errors import InputError, error_context
from skystack.io.files import read_whole
from skystack.io.json_file import decode

FORMAT = 1
FILE = "measured.json"


class Measured(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Rows of `skystack evaluate` of one policy, and how they came about."""

    format: int
    sha256: str
    """Of the weights, as `policy.json` states it: of which policy this was measured."""
    machine: str
    version: str
    """Of skystack."""
    git_revision: str | None
    """Of the code that measured; `-dirty` where it was changed."""
    rows: list[dict[str, Any]]
    """As `skystack evaluate --json` gives them, each with its `command`; unstacked, then stacked,
    then stacked on more scenarios."""

    @property
    def stacked(self) -> dict[str, Any]:
        """The row that `skystack evaluate NAME` shows."""
        return next(row for row in self.rows if row["stacking"])


def read_measured(folder: Path) -> Measured | None:
    """What was measured of the policy in a folder, None where nothing was.

    Raises InputError for a damaged file.
    """
    path = folder / FILE
    if not path.exists():
        return None
    with error_context(str(path)):
        measured = decode(read_whole(path), Measured, "cannot be read")
    if measured.format != FORMAT:
        raise InputError(f"{path}: format {measured.format} (allowed: {FORMAT})")
    return measured


def to_json(measured: Measured) -> bytes:
    """The contents of `measured.json`."""
    return (json.dumps(msgspec.to_builtins(measured), indent=2) + "\n").encode()
