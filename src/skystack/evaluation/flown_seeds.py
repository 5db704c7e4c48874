"""Finished hours on disk: their scores and tables, one file per seed, with what they depend on."""

import hashlib
from collections.abc import Mapping
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa

from skystack.errors import InputError, exists
from skystack.evaluation.controllers import ControlledWorld
from skystack.evaluation.hour_scores import Scores
from skystack.evaluation.hour_tables import TABLES
from skystack.evaluation.scenario_traffic import is_scenario
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.io.files import atomic_write, file_digest, read_whole

_HASH_BYTES = hashlib.sha256().digest_size


class FlownSeed(NamedTuple):
    """A flown hour."""

    scores: Scores
    tables: Mapping[str, pa.Table]
    """`skystack.evaluation.hour_tables.tables_of`."""
    files: Mapping[str, str] = {}
    """The files that a user's class was imported from, with their digests."""


class _File(NamedTuple):
    seed: int
    conditions: str
    """`conditions_digest`."""
    scores: Scores
    tables: dict[str, bytes]
    """In the format of Arrow's streams."""
    files: dict[str, str]


def conditions_digest(found: ControlledWorld, conditions: TrafficConditions) -> str:
    """A digest of the agent, the conditions and the source of this package.

    It does not cover installed libraries, or modules that a user's class imports (`FlownSeed.files`
    does).
    """
    file = Path(conditions.traffic)
    is_file = is_scenario(conditions.traffic) and exists(file)
    parts: list[Any] = [
        *(found.name, found.digest, found.performance, found.per_cycle, found.safety_net),
        *(conditions.traffic, conditions.cycles, conditions.uncertainty, conditions.platform),
        found.world.sector,
        file_digest(file) if is_file else "",
        _source_digest(),
    ]
    return hashlib.sha256(msgspec.json.encode(parts)).hexdigest()


@cache
def _source_digest() -> str:
    """A digest of the source of this package."""
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(f"{path.relative_to(package)}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def write_seed(folder: Path, seed: int, digest: str, flown: FlownSeed) -> None:
    """Write a flown hour. Raises InputError if the file cannot be written."""
    tables = {name: _as_bytes(table) for name, table in flown.tables.items()}
    data = msgspec.msgpack.encode(
        _File(seed, digest, flown.scores, tables, dict(flown.files)), enc_hook=np.ndarray.tolist
    )
    atomic_write(_path(folder, seed), hashlib.sha256(data).digest() + data)


def read_seed(folder: Path, seed: int, digest: str) -> FlownSeed | None:
    """Read a flown hour.

    None if it is missing or damaged, or flown under other conditions, or if a file of the user's
    class has changed since.
    """
    try:
        data = read_whole(_path(folder, seed))
        stored, data = data[:_HASH_BYTES], data[_HASH_BYTES:]
        if stored != hashlib.sha256(data).digest():
            return None
        file = msgspec.msgpack.decode(data, type=_File, dec_hook=lambda _, value: np.array(value))
        if (file.seed, file.conditions) != (seed, digest) or set(file.tables) != set(TABLES):
            return None
        if any(file_digest(Path(path)) != known for path, known in file.files.items()):
            return None
        tables = {name: _as_table(of) for name, of in file.tables.items()}
        return FlownSeed(file.scores, tables, file.files)
    except (InputError, OSError, ValueError, msgspec.MsgspecError, pa.ArrowException):
        return None


def is_flown(folder: Path, seed: int) -> bool:
    """Whether there is a file of a seed, perhaps flown under other conditions."""
    return exists(str(_path(folder, seed)))


def _path(folder: Path, seed: int) -> Path:
    return folder / f"seed-{seed}.hour"


def _as_bytes(table: pa.Table) -> bytes:
    file = BytesIO()
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with pa.ipc.new_stream(file, table.schema, options=options) as writer:
        writer.write_table(table)
    return file.getvalue()


def _as_table(data: bytes) -> pa.Table:
    with pa.ipc.open_stream(data) as reader:
        return reader.read_all()
