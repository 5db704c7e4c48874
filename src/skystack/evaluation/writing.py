"""Write Parquet tables with their sector in parts, so that only one part is in memory."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from skystack.airspace.sector import Sector
from skystack.evaluation.fixed_traffic import is_fixed
from skystack.evaluation.scenario_traffic import is_scenario
from skystack.io.files import atomic_files, writing
from skystack.platforms.registry import OWN
from skystack.simulator.fleet import AircraftType

SECTOR, PERFORMANCE_MODEL, FLEET = b"sector", b"performance", b"fleet"
SCENARIOS = b"scenarios"
"""Metadata key: the lowest and highest scenario of each row group, as JSON. Readers use it to find
scenarios, because pyarrow aborts the process when it reads the statistics of a damaged file."""
TRAFFIC = b"traffic"
"""Metadata key: the traffic and the agent, as JSON, if the scenarios are hours of traffic."""
EVALUATION = b"evaluation"
"""Metadata key: a digest that tables have in common only if they were written together."""
GROUP_ROWS = 65_536
"""Rows of every row group except the last, independent of the size of the appended parts."""

Append = Callable[[Mapping[str, pa.Table]], None]
"""Appends a part to each table of a folder, by name."""


SESSION = "session"
"""The agent in recordings of live sessions: a person, advised or not."""


class TrafficRecord(msgspec.Struct, frozen=True):
    """Which arriving traffic was flown, under which agent."""

    agent: str
    traffic: str
    """Flights per hour, or the name of the traffic."""
    seed: int
    uncertainty: bool
    safety_net: bool | None = None
    """Whether the agent flew with its safety net; None if it has none."""
    platform: str = OWN
    """The simulator."""

    def is_same_as(self, other: "TrafficRecord | None") -> bool:
        """Whether the traffic is the same, whatever the agent.

        Fixed traffic and scenarios are the same in all simulators.
        """
        if other is None:
            return False
        same = msgspec.structs.replace(other, agent=self.agent, safety_net=self.safety_net)
        if is_fixed(self.traffic) or is_scenario(self.traffic):
            same = msgspec.structs.replace(same, platform=self.platform)
        return self == same


def table_metadata(
    sector: Sector,
    performance: str,
    types: Sequence[AircraftType] = (),
    traffic: TrafficRecord | None = None,
) -> dict[bytes, bytes]:
    """The metadata of every table: sector, performance model and, if there is one, fleet.

    `traffic` is that of tables of hours.
    """
    fleet = {FLEET: msgspec.json.encode(types)} if types else {}
    arriving = {} if traffic is None else {TRAFFIC: msgspec.json.encode(traffic)}
    known = {SECTOR: msgspec.json.encode(sector), PERFORMANCE_MODEL: performance.encode()}
    return known | fleet | arriving


def write_table(
    path: Path,
    table: pa.Table,
    sector: Sector,
    performance: str,
    types: Sequence[AircraftType] = (),
    embedded: Mapping[str, list[dict[str, Any]]] | None = None,
) -> None:
    """Write one table as Parquet, with sector, performance model and fleet in the metadata.

    `embedded` are small tables that are stored in the metadata as JSON. Raises InputError if the
    file cannot be written.
    """
    metadata = table_metadata(sector, performance, types)
    metadata |= {key.encode(): msgspec.json.encode(rows) for key, rows in (embedded or {}).items()}
    with (
        atomic_files([path]) as [file],
        writing(path),
        closing(_GrowingTable(file, metadata)) as growing,
    ):
        growing.append(table)
        growing.end({})


@contextmanager
def growing_tables(
    folder: Path,
    names: Sequence[str],
    metadata: Mapping[bytes, bytes],
    outdated: Sequence[Path] = (),
) -> Iterator[Append]:
    """Tables `<name>.parquet` in a folder, to which the body must append at least once.

    At the end, all files are replaced together, and the `outdated` ones are deleted; if the body
    raises, none is changed. Their content does not depend on the division into parts. Raises
    InputError for a file that cannot be written.
    """
    paths = [folder / f"{name}.parquet" for name in names]
    with atomic_files(paths, outdated) as files, ExitStack() as stack:
        growing = [stack.enter_context(closing(_GrowingTable(file, metadata))) for file in files]
        digest = _Digest()

        def append(tables: Mapping[str, pa.Table]) -> None:
            digest.update(tables[names[0]])
            for name, path, table in zip(names, paths, growing, strict=True):
                with writing(path):
                    table.append(tables[name])

        yield append
        for path, table in zip(paths, growing, strict=True):
            with writing(path):
                table.end({EVALUATION: digest.hex().encode()})


class _Digest:
    """A digest of a table's numbers that does not depend on how it is divided into parts."""

    def __init__(self) -> None:
        self._columns: dict[str, Any] = {}

    def update(self, table: pa.Table) -> None:
        for field in table.schema:
            if pa.types.is_primitive(field.type):
                column = self._columns.setdefault(field.name, sha256())
                column.update(table[field.name].to_numpy().tobytes())

    def hex(self) -> str:
        columns = (f"{name} {column.hexdigest()}\n" for name, column in self._columns.items())
        return sha256("".join(columns).encode()).hexdigest()[:32]


class _GrowingTable:
    """A Parquet file that is written one row group at a time."""

    def __init__(self, file: IO[bytes], metadata: Mapping[bytes, bytes]) -> None:
        self._file, self._metadata = file, metadata
        self._writer: Any = None
        self._pending: list[pa.Table] = []
        self._scenarios: list[tuple[int, int]] = []

    def close(self) -> None:
        """Close the writer; without `end` the file is not a valid table."""
        if self._writer is not None:
            with suppress(Exception):  # on a full disk pyarrow would retry when garbage-collected
                self._writer.close()
            self._writer.is_open = False

    def append(self, table: pa.Table) -> None:
        if self._writer is None:
            schema = table.schema.with_metadata(self._metadata)
            self._writer = pq.ParquetWriter(self._file, schema, compression="zstd")
        self._pending.append(table)
        if sum(each.num_rows for each in self._pending) >= GROUP_ROWS:
            self._write(GROUP_ROWS)

    def end(self, metadata: Mapping[bytes, bytes]) -> None:
        """Write the remaining rows, the index, and metadata that is only known at the end."""
        self._write(1)
        index = {SCENARIOS: msgspec.json.encode(self._scenarios)} if self._scenarios else {}
        if index or metadata:
            self._writer.add_key_value_metadata({**index, **metadata})
        self._writer.close()

    def _write(self, least: int) -> None:
        """Write pending rows, one row group at a time, while at least `least` are left."""
        rows = pa.concat_tables(self._pending).combine_chunks()
        while rows.num_rows >= least:
            group = rows.slice(0, GROUP_ROWS)
            self._writer.write_table(group, row_group_size=GROUP_ROWS)
            if "scenario" in group.column_names:
                span = pc.min_max(group["scenario"]).as_py()
                self._scenarios.append((span["min"], span["max"]))
            rows = rows.slice(GROUP_ROWS)
        self._pending = [rows]
