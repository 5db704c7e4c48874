"""The table for the traffic library: columns, units and times against the evaluation's tables."""

import sys
from datetime import UTC, datetime, timedelta

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skystack.cli import main
from skystack.errors import InputError
from skystack.export.traffic_frame import START, traffic_frame
from tests.scenarios import EXAMPLES

from .conftest import EPISODES, evaluation_of

pytest.importorskip("pandas")
NAMES = ["timestamp", "flight_id", "icao24", "callsign", "latitude", "longitude", "altitude"]
NAMES += ["groundspeed", "track", "vertical_rate", "scenario", "status"]


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["lateral-best", "vertical"])
def test_rows_have_the_values_of_the_table_in_the_units_of_traffic(out, policy):
    folder = evaluation_of(out, policy)
    table = pq.read_table(folder / "trajectories.parquet").to_pydict()
    frame = traffic_frame(folder)
    assert list(frame.columns) == NAMES
    for name, column, factor in (
        ("latitude", "lat", 1.0),
        ("longitude", "lon", 1.0),
        ("altitude", "fl", 100.0),
        ("groundspeed", "ground_speed_kt", 1.0),
        ("vertical_rate", "vertical_speed_ft_min", 1.0),
    ):
        expected = factor * np.array(table[column])
        np.testing.assert_allclose(frame[name], expected, rtol=1e-7, atol=1e-12, err_msg=name)
        assert frame[name].dtype == np.float64
    turned = (frame["track"] - table["heading_deg"]) % 360.0
    np.testing.assert_allclose(np.minimum(turned, 360.0 - turned), 0.0, atol=1e-4)
    assert frame["track"].between(0.0, 360.0, inclusive="left").all()
    assert list(frame["scenario"]) == table["scenario"]
    assert list(frame["status"]) == table["status"]
    assert list(frame["callsign"]) == table["callsign"]
    ids = zip(table["scenario"], table["callsign"], strict=True)
    assert list(frame["flight_id"]) == [f"{number}-{callsign}" for number, callsign in ids]
    addresses = frame.groupby("flight_id")["icao24"].unique()
    assert sorted(address for (address,) in addresses) == [
        f"{number:06x}" for number in range(1, len(addresses) + 1)
    ]


def test_altitude_and_speeds_belong_together(out):
    """The change of the altitude is the vertical rate, in ft and ft/min."""
    frame = traffic_frame(evaluation_of(out, "vertical"))
    one = frame[frame["flight_id"] == frame["flight_id"].iloc[0]]
    minutes = one["timestamp"].diff().dt.total_seconds() / 60.0
    climbed = one["altitude"].diff() / minutes
    rates = one["vertical_rate"]
    assert rates.abs().max() > 500.0
    assert climbed.median() == pytest.approx(rates.median(), abs=50.0)


def test_scenarios_start_hours_apart(folder):
    frame = traffic_frame(folder)
    table = pq.read_table(folder / "trajectories.parquet").to_pydict()
    rows = zip(table["scenario"], table["time_s"], strict=True)
    expected = [START + timedelta(hours=number, seconds=time_s) for number, time_s in rows]
    assert list(frame["timestamp"]) == expected
    assert str(frame["timestamp"].dtype) == "datetime64[ns, UTC]"
    assert frame["scenario"].nunique() == EPISODES
    later = datetime(2026, 7, 1, 12, tzinfo=UTC)
    second = traffic_frame(folder / "trajectories.parquet", scenario=1, start=later)
    assert second["scenario"].unique().tolist() == [1]
    assert second["timestamp"].min() == later + timedelta(hours=1)


def test_long_scenarios_start_further_apart(tmp_path):
    columns = {name: [0.0] * 4 for name in ("lat", "lon", "fl", "heading_deg", "ground_speed_kt")}
    columns |= {"vertical_speed_ft_min": [0.0] * 4, "callsign": ["A"] * 4, "status": ["s"] * 4}
    columns |= {"scenario": [0, 0, 3, 3], "time_s": [0, 3600, 0, 6]}
    pq.write_table(pa.table(columns), tmp_path / "long.parquet")
    times = traffic_frame(tmp_path / "long.parquet")["timestamp"] - START
    assert (times.dt.total_seconds() / 3600.0).round(3).tolist() == [0.0, 1.0, 6.0, 6.002]
    pq.write_table(pa.table(columns | {"scenario": [900_000_000] * 4}), tmp_path / "far.parquet")
    with pytest.raises(InputError, match="more than 200 years after the start"):
        traffic_frame(tmp_path / "far.parquet")


@pytest.mark.parametrize("scenario", [True, -1, 10**30])
def test_names_an_invalid_scenario(folder, scenario):
    with pytest.raises(InputError, match="scenario is"):
        traffic_frame(folder, scenario)


@pytest.mark.parametrize("start", [datetime(2024, 1, 1), datetime.min.replace(tzinfo=UTC)])
def test_names_an_invalid_start(folder, start):
    with pytest.raises(InputError, match=r"start is .*time zone, from 1701 to 2049"):
        traffic_frame(folder, start=start)


def test_reads_the_file_of_simulate(tmp_path, capsys):
    target = tmp_path / "flown.parquet"
    assert main(["simulate", str(EXAMPLES / "head-on.json"), "-o", str(target)]) == 0
    capsys.readouterr()
    frame = traffic_frame(target)
    assert list(frame.columns) == NAMES
    assert set(frame["flight_id"]) == {f"0-{callsign}" for callsign in set(frame["callsign"])}
    with pytest.raises(InputError, match=r"scenario is 1 \(allowed: only for an evaluation\)"):
        traffic_frame(target, scenario=1)


def test_rejects_missing_tables_scenarios_and_pandas(folder, tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"trajectories\.parquet: missing"):
        traffic_frame(tmp_path)
    with pytest.raises(InputError, match="has no scenario 99"):
        traffic_frame(folder, scenario=99)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="needs pandas, which is not installed"):
        traffic_frame(folder)
