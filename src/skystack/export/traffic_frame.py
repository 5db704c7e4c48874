"""Flights as a pandas table for the traffic library, which analyses and draws trajectories."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from skystack.errors import MAX_INT, InputError, checked_integer
from skystack.evaluation.stored import has_column, read_table
from skystack.io.files import AnyPath

COLUMNS = {
    "lat": "latitude",
    "lon": "longitude",
    "fl": "altitude",
    "ground_speed_kt": "groundspeed",
    "heading_deg": "track",
    "vertical_speed_ft_min": "vertical_rate",
}
"""Columns of trajectories with their names in traffic; only the altitude has another unit."""
START = datetime(2000, 1, 1, tzinfo=UTC)
HOUR_S = 3600
LONGEST_S = 200 * 365 * 24 * HOUR_S
"""Timestamps in nanoseconds end in 2262."""


def traffic_frame(path: AnyPath, scenario: int | None = None, start: datetime = START) -> Any:
    """The trajectories of an evaluation, or of `simulate`, as a DataFrame for `traffic.core`.

    `path` is the folder of an evaluation, or a Parquet file; `scenario` selects one scenario. Each
    row is an aircraft in a radar cycle: `timestamp` (UTC), `flight_id` (scenario and callsign),
    `icao24` (a running number of the flights, not a real address), `callsign`, `latitude` and
    `longitude` (degrees), `altitude` (ft), `groundspeed` (kt), `track` (degrees; there is no wind),
    `vertical_rate` (ft/min), `scenario` and `status`. Scenario n starts n hours after `start` (n
    times a longer period if a scenario lasts an hour or more), so that flights of different
    scenarios are never in the air at the same time.

    Raises InputError if the table is missing, damaged or too large, if there is no such scenario,
    or if pandas is not installed.
    """
    pandas = _pandas()
    if scenario is not None:
        scenario = checked_integer("scenario", scenario, 0, MAX_INT)
    begin = _checked_start(start)
    path = Path(path)
    file = path / "trajectories.parquet" if path.is_dir() else path
    numbered = has_column(file, "scenario")  # simulate flies a single scenario, without a number
    if scenario is not None and not numbered:
        raise InputError(f"scenario is {scenario} (allowed: only for an evaluation)")
    names = ["time_s", "callsign", "status", *COLUMNS, *["scenario"] * numbered]
    table = read_table(file, names, None if scenario is None else [("scenario", "=", scenario)])
    if not table.num_rows:
        raise InputError(f"{file}: has no scenario {'' if scenario is None else scenario}".rstrip())
    time_s = table["time_s"].to_numpy().astype(np.int64)
    number = table["scenario"].to_numpy().astype(np.int64) if numbered else np.zeros_like(time_s)
    elapsed_s = time_s + number * (time_s.max() // HOUR_S + 1) * HOUR_S
    if elapsed_s.max() > LONGEST_S:
        raise InputError(f"{file}: scenario {number.max()} is more than 200 years after the start")
    callsign = np.array(table["callsign"].to_pylist(), dtype=object)
    values = {new: table[old].to_numpy().astype(float) for old, new in COLUMNS.items()}
    values["altitude"] *= 100.0
    values["track"] %= 360.0
    signs = zip(number.tolist(), callsign.tolist(), strict=True)
    flight_id = [f"{scenario}-{sign}" for scenario, sign in signs]
    icao24 = {flight: f"{index:06x}" for index, flight in enumerate(dict.fromkeys(flight_id), 1)}
    head = {
        "timestamp": pandas.Timestamp(begin).as_unit("ns")
        + pandas.to_timedelta(elapsed_s, unit="s").as_unit("ns"),
        "flight_id": flight_id,
        "icao24": [icao24[flight] for flight in flight_id],
        "callsign": callsign,
    }
    tail = {"scenario": number, "status": table["status"].to_pylist()}
    return pandas.DataFrame(head | values | tail)


def _checked_start(start: Any) -> datetime:
    """The start in UTC. Raises InputError unless it has a time zone and is from 1701 to 2049."""
    if not isinstance(start, datetime) or start.tzinfo is None or not 1700 < start.year < 2050:
        raise InputError(
            f"start is {start!r} (allowed: a datetime with a time zone, from 1701 to 2049)"
        )
    return start.astimezone(UTC)


def _pandas() -> Any:
    try:
        import pandas  # noqa: PLC0415
    except ImportError:
        raise InputError(
            "traffic_frame needs pandas, which is not installed (the traffic library installs it)"
        ) from None
    return pandas
