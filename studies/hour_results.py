"""Results of flown hours, stored in the repository as one JSON object per line."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa

from skystack.errors import InputError, error_context, exists
from skystack.evaluation.hour_row import ROW_FILE, HourRow
from skystack.evaluation.stored import read_table
from skystack.io.files import atomic_write, make_folder, read_whole
from skystack.io.json_file import decode, read_json
from skystack.io.validation import convert
from skystack.simulator.simulator import CYCLE_S

RESULTS = Path(__file__).parent.parent / "docs" / "results" / "flight-school.jsonl"
MAX_BYTES = 10_000_000
SOON_S = 60
"""A transmission to a flight within this time could have been combined with the previous one."""
COLUMNS = ("scenario", "cycle", "transmission", "callsign", "kind")
AIRCRAFT_COLUMNS = ("birth_cycle", "entry_cycle", "gone_cycle")


class Case(NamedTuple):
    """A controller on some traffic in a simulator."""

    agent: str
    traffic: str
    platform: str


def case_of(row: HourRow) -> Case:
    return Case(row.agent, row.traffic, row.platform)


class Spoken(msgspec.Struct, frozen=True):
    """Shares of the transmissions."""

    again_soon: float
    """Within `SOON_S` of another transmission to the same flight."""
    level: float
    """With a level."""
    heading: float
    direct: float
    combined: float
    """With a level, and a heading or a fix."""


def spoken(clearances: pa.Table) -> Spoken | None:
    """What was transmitted; None if nothing was."""
    if not clearances.num_rows:
        return None
    keys = ["scenario", "transmission", "callsign", "cycle"]
    kinds = clearances.group_by(keys).aggregate([("kind", "list")]).sort_by(
        [("scenario", "ascending"), ("callsign", "ascending"), ("cycle", "ascending")]
    )  # fmt: skip
    total, parts = kinds.num_rows, kinds["kind_list"].to_pylist()
    flights = list(zip(kinds["scenario"].to_pylist(), kinds["callsign"].to_pylist(), strict=True))
    cycles = kinds["cycle"].to_pylist()
    again = sum(
        flights[at] == flights[at - 1] and (cycles[at] - cycles[at - 1]) * CYCLE_S <= SOON_S
        for at in range(1, total)
    )

    def share(kind: str) -> float:
        return sum(kind in each for each in parts) / total

    combined = sum(len(each) > 1 for each in parts) / total
    return Spoken(again / total, share("level"), share("heading"), share("direct"), combined)


def late_entries(exited: pa.Table) -> float | None:
    """The share of flights that spent most of their time outside, before they entered.

    `exited` has the `AIRCRAFT_COLUMNS` of the flights that left through their exit. None if none
    did.
    """
    born, entered, gone = (exited[name].to_numpy() for name in AIRCRAFT_COLUMNS)
    return float(np.mean(entered - born > gone - entered)) if len(gone) else None


class Result(msgspec.Struct, frozen=True):
    """The results of a controller on some traffic in a simulator."""

    flown: str
    """The date on which the result was stored, as in 2026-11-29. Reused seeds may be older."""
    row: dict[str, Any]
    """The row that `skystack flight-school` writes."""
    spoken: Spoken | None
    late_entries: float | None = None
    """As the function `late_entries` returns it; also None if it was not computed."""

    @property
    def hour_row(self) -> HourRow:
        found: HourRow = convert(self.row, HourRow)
        return found


def read_results(path: Path) -> list[Result]:
    """All results in a file; none if there is no file.

    Raises InputError for a damaged line, or if two lines have results for the same case.
    """
    if not exists(path):
        return []
    results, lines = list[Result](), dict[Case, int]()
    with error_context(str(path)):
        for at, line in enumerate(read_whole(path, MAX_BYTES).splitlines(), start=1):
            results.append(decode(line, Result, f"line {at}"))
            with error_context(f"line {at}"):
                case = case_of(results[-1].hour_row)
                if case in lines:
                    raise InputError(f"{', '.join(case)} is already in line {lines[case]}")
            lines[case] = at
    return results


def write_results(path: Path, results: Sequence[Result]) -> None:
    """Replace the results in a file. Raises InputError if it cannot be written."""
    make_folder(path.parent)
    atomic_write(path, b"".join(msgspec.json.encode(each) + b"\n" for each in results))


def result_in(folder: Path, flown: str = "") -> Result:
    """The results in a folder of `skystack flight-school`."""
    with error_context(str(folder / ROW_FILE)):
        row = read_json(folder / ROW_FILE)
    filters = [("exited", "=", True)]
    exited = read_table(folder / "aircraft.parquet", AIRCRAFT_COLUMNS, filters)
    return Result(flown, row, spoken_in(folder), late_entries(exited))


def spoken_in(folder: Path) -> Spoken | None:
    """What was transmitted in the hours of a folder."""
    table = read_table(folder / "clearances.parquet", COLUMNS)
    texts = {name: table[name].cast(pa.string()) for name in ("callsign", "kind")}
    for name, column in texts.items():
        table = table.set_column(table.column_names.index(name), name, column)
    return spoken(table)
