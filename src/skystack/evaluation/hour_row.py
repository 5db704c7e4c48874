"""The row of results of an agent on hours of traffic, as stored with the tables."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec

from skystack.errors import MAX_INT, error_context, exists
from skystack.evaluation.traffic_conditions import is_named
from skystack.io.files import atomic_write
from skystack.io.json_file import read_json
from skystack.io.validation import convert
from skystack.platforms.registry import OWN
from skystack.simulator.arrival_flows import MAX_FLIGHTS_PER_HOUR
from skystack.simulator.simulator import CYCLE_S

ROW_FILE = "row.json"
_Count = Annotated[int, msgspec.Meta(ge=0, le=MAX_INT)]
_Rate = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
_Value = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
_Amount = Annotated[float, msgspec.Meta(ge=0.0, le=1e9)]
_Name = Annotated[str, msgspec.Meta(min_length=1, max_length=200)]


class HourRow(msgspec.Struct, frozen=True, kw_only=True):
    """What reports show of a row; the file has more. None where there was nothing to average."""

    agent: _Name
    traffic: _Name
    """Flights per hour, or the name of the traffic."""
    sector: _Name
    hours: Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
    seed: _Count
    seed_numbers: list[_Count] | None = None
    """All seeds, if there are several; `seed` is the first."""
    failed_seeds: list[_Count] = []
    """The seeds that failed. The row covers only the others."""
    per_cycle: _Count | None
    """None without a limit of transmissions."""
    uncertainty: bool
    safety_net: bool | None
    """None if the agent has none."""
    platform: _Name = OWN
    flights: _Count
    losses_of_separation: _Count
    losses_at_birth: _Count
    correct_exit_rate: _Rate | None
    excursion_rate: _Rate | None
    fail_safe_rate: _Rate
    transmissions_per_flight: _Amount | None
    transmissions_worst_minute: _Count
    extra_miles_rate: _Value | None
    cycles: Annotated[int, msgspec.Meta(ge=1, le=100_000)]
    """The length of each hour: 600, or that of the scenario, unless `--cycles` was given."""
    lax_s_mean: _Amount
    lax_s_by_hour: Annotated[list[_Amount], msgspec.Meta(min_length=1)]
    lax_without_births_s_mean: _Amount = 0.0
    strict_s_mean: _Amount
    lax_s_interval: tuple[_Value, _Value] | None = None
    """95 % confidence interval of the mean; None for fewer than two seeds."""
    strict_s_interval: tuple[_Value, _Value] | None = None
    lax_ended_by: dict[_Name, _Count] = {}
    """The number of hours ended by each cause."""
    losses_per_flight_hour: _Amount | None = None
    decision_ms_median: _Amount

    @property
    def seeds(self) -> list[int]:
        """The seeds of the hours."""
        return self.seed_numbers or [self.seed]

    @property
    def length_s(self) -> float:
        """The length of each hour in seconds."""
        return float(CYCLE_S * self.cycles)

    @property
    def flights_per_hour(self) -> float | None:
        """None for traffic that has a name instead of a rate."""
        return None if is_named(self.traffic) else float(self.traffic)

    def __post_init__(self) -> None:
        if not is_named(self.traffic) and not _is_rate(self.traffic):
            raise ValueError(f"traffic is {self.traffic!r} (allowed: a rate or a known name)")


def _is_rate(text: str) -> bool:
    try:
        return 0.0 < float(text) <= MAX_FLIGHTS_PER_HOUR
    except ValueError:
        return False


def write_row(folder: Path, row: Mapping[str, Any]) -> None:
    """Write a row into the folder of its tables."""
    atomic_write(folder / ROW_FILE, msgspec.json.format(msgspec.json.encode(row), indent=1))


def read_row(folder: Path) -> HourRow:
    """Read the row in a folder. Raises InputError if it is missing or damaged."""
    path = folder / ROW_FILE
    with error_context(str(path)):
        row: HourRow = convert(read_json(path), HourRow)
    return row


def folders_of_hours(folder: Path) -> list[Path]:
    """The folders with rows: the folder itself, or those in it."""
    if exists(folder / ROW_FILE):
        return [folder]
    return sorted(path.parent for path in folder.glob(f"*/{ROW_FILE}"))
