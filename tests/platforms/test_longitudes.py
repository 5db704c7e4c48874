"""A sector across the 180th meridian is flown like the same sector elsewhere, on every platform.

The earth is an ellipsoid of revolution, so X-Plus moved by 180 degrees of longitude must give the
same flights, moved.
"""

from dataclasses import replace

import numpy as np
import pytest

from skystack.airspace.projection import wrap_longitude
from skystack.airspace.sector import Sector
from skystack.airspace.xplus import x_plus
from skystack.evaluation.followed import STATUS, follow
from skystack.platforms.flight import fly_scenario
from skystack.platforms.registry import open_platform
from skystack.simulator.scenario_file import Aircraft, Scenario, ScheduledClearance

HERE = x_plus()


def moved(lat_lon):
    return lat_lon[0], float(wrap_longitude(lat_lon[1] + 180.0))


THERE = Sector(
    name="dateline",
    levels_fl=HERE.levels_fl,
    area=tuple(moved(corner) for corner in HERE.area),
    fixes={name: moved(place) for name, place in HERE.fixes.items()},
    routes=HERE.routes,
    origin=moved(HERE.origin),
)
NAVIGATING = next(route for route in HERE.routes if (route[0], route[-1]) == ("HERON", "ROBIN"))
WESTBOUND = next(route for route in HERE.routes if (route[0], route[-1]) == ("ROBIN", "HERON"))


def scenario():
    """One aircraft on own navigation, and one that is turned across the meridian and back."""
    places = {route: HERE.fixes[route[0]] for route in (NAVIGATING, WESTBOUND)}
    flying = (
        Aircraft("AC1", "B753", NAVIGATING, *places[NAVIGATING], 300.0, 45.19, 300, True),
        Aircraft("AC2", "B753", WESTBOUND, *places[WESTBOUND], 280.0, 284.9, 280, False),
    )
    turns = ((60, 350), (75, 90), (100, 250))
    clearances = tuple(ScheduledClearance(cycle, "AC2", heading) for cycle, heading in turns)
    return Scenario(HERE, "table", 150, flying, clearances)


def moved_scenario(flown):
    aircraft = tuple(
        replace(one, lat=moved((one.lat, one.lon))[0], lon=moved((one.lat, one.lon))[1])
        for one in flown.aircraft
    )
    return replace(flown, sector=THERE, aircraft=aircraft)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["skystack", "bluebird", "bluesky"])
def test_flies_the_same_across_the_180th_meridian(name, tmp_path):
    if name != "skystack":
        pytest.importorskip({"bluebird": "bluebird_dt"}.get(name, name))
    here = scenario()
    platform = open_platform(name, tmp_path)
    try:
        flights = [fly_scenario(platform, flown).reports for flown in (here, moved_scenario(here))]
    finally:
        platform.close()
    first, second = (np.array(reports) for reports in flights)
    lon = second[:, 1]
    assert lon.min() < -179.5  # on both sides of the meridian
    assert lon.max() > 179.5
    assert np.all((lon >= -180.0) & (lon < 180.0))
    # 1e-5 degrees are 0.0006 NM: skystack accumulates positions in float32.
    np.testing.assert_allclose(second[:, 0], first[:, 0], rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(wrap_longitude(lon - 180.0), first[:, 1], rtol=0.0, atol=1e-5)
    np.testing.assert_allclose(second[:, 2:], first[:, 2:], rtol=0.0, atol=0.02)
    followed_flights = [follow(here, flights[0]), follow(moved_scenario(here), flights[1])]
    np.testing.assert_array_equal(followed_flights[0].status, followed_flights[1].status)
    assert STATUS[followed_flights[0].status[-1, 0]] == "exited"
