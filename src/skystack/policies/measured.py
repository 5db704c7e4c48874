"""The measured results of a shipped policy: `measured.json` in its folder."""

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
    """Rows of `skystack evaluate` for one policy, and their provenance."""

    format: int
    sha256: str
    """The hash of the weights from `policy.json`. It identifies the measured policy."""
    machine: str
    version: str
    """The version of skystack."""
    git_revision: str | None
    """The revision of the code, with the suffix `-dirty` if the working tree was modified."""
    rows: list[dict[str, Any]]
    """The rows of `skystack evaluate --json`, each with its `command`: unstacked, then stacked,
    then stacked on more scenarios. For sector control, one row for each traffic."""

    @property
    def stacked(self) -> dict[str, Any] | None:
        """The row that `skystack evaluate NAME` prints; None for sector control."""
        return next((row for row in self.rows if row.get("stacking")), None)


def read_measured(folder: Path) -> Measured | None:
    """The measured results of the policy in a folder, or None if there are none.

    Raises InputError for a damaged file.
    """
    path = folder / FILE
    if not path.exists():
        return None
    with error_context(str(path)):
        data = read_whole(path)
    measured: Measured = decode(data, Measured, str(path))
    if measured.format != FORMAT:
        raise InputError(f"{path}: format {measured.format} (allowed: {FORMAT})")
    return measured


def to_json(measured: Measured) -> bytes:
    """The contents of `measured.json`."""
    return (json.dumps(msgspec.to_builtins(measured), indent=2) + "\n").encode()
