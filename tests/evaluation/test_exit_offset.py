"""Exit offsets agree with the flown trajectories, by shapely and pyproj, in several sectors."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from pyproj import Geod
from shapely import LineString

from skystack.airspace.sectors import find_sector
from skystack.evaluation.evaluate import Conditions, evaluate, evaluate_no_op
from skystack.learning.experiment import load_experiment
from skystack.policies.shipped import find_policy

TOLERANCE_NM = 0.02
"""Shapely intersects straight lines of degrees, which differ a little from those of the plane."""


def crossing(sector, rows, route):
    """The exit fix of a route, and where the last flown segment crosses the sector's edge."""
    exited = next(n for n, status in enumerate(rows["status"]) if status == "exited")
    flown = LineString([(rows["lon"][n], rows["lat"][n]) for n in (exited - 1, exited)])
    area = [(lon, lat) for lat, lon in sector.area]
    lat, lon = sector.fixes[route.split()[-2]]
    return (lon, lat), flown.intersection(LineString([*area, area[0]]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("policy", "sector"), [("lateral-best", "x-plus"), ("lateral", "merge"), ("vertical", "x-plus")]
)
def test_offset_is_the_distance_from_the_exit_fix_at_the_crossing(policy, sector, tmp_path):
    flown = evaluate(find_policy(policy), Conditions(episodes=20, sector=sector), tmp_path)
    (folder,) = tmp_path.iterdir()
    aircraft = pq.read_table(folder / "aircraft.parquet").to_pylist()
    trajectories = pq.read_table(folder / "trajectories.parquet").to_pandas()
    by_flight = trajectories.groupby(["scenario", "callsign"], observed=True)
    checked = 0
    for each in aircraft:
        rows = by_flight.get_group((each["scenario"], each["callsign"]))
        rows = {name: rows[name].tolist() for name in ("lat", "lon", "status")}
        assert (each["exit_offset_nm"] is None) == ("exited" not in rows["status"])
        if each["exit_offset_nm"] is not None:
            fix, at = crossing(find_sector(sector), rows, each["route"])
            metres = Geod(ellps="WGS84").inv(*fix, at.x, at.y)[2]
            assert each["exit_offset_nm"] == pytest.approx(metres / 1852.0, abs=TOLERANCE_NM)
            checked += 1
    assert checked >= 15
    offsets = [each["exit_offset_nm"] for each in aircraft if each["exit_offset_nm"] is not None]
    assert flown.row["exit_offset_nm_mean"] == pytest.approx(np.mean(offsets), rel=1e-5)
    assert flown.episodes["exits"].to_numpy().sum() == len(offsets)


@pytest.mark.slow
@pytest.mark.parametrize("before_nm", [0.0, 5.0])
def test_no_offset_exceeds_half_the_width_of_the_exit(before_nm):
    """The offset is measured from the middle of the exit, wherever it lies."""
    settings = [f"task.exit_before_nm={before_nm}", "task.exit_nm=3.0", "task.disc_nm=20.0"]
    flown = evaluate_no_op(load_experiment("lateral", settings), Conditions(episodes=200), None)
    offsets = flown.episodes["exit_offset_nm"].drop_null().to_numpy()
    assert len(offsets) >= 5
    assert 1.5 < offsets.max() <= 3.01


@pytest.mark.slow
def test_row_without_an_exit_has_no_offset():
    # The shortest scenario that the task allows: only a perfect flight could end in it.
    experiment = load_experiment("lateral", ["task.cycles=98"])
    flown = evaluate_no_op(experiment, Conditions(episodes=3), None)
    assert flown.row["exit_offset_nm_mean"] is None
    assert flown.episodes["exits"].to_pylist() == [0, 0, 0]
    assert flown.episodes["exit_offset_nm"].null_count == 3
