"""Instructed flights against rollouts of BluebirdDT: headings, levels and positions by row."""

from functools import cache

import numpy as np
import pytest

from skystack.airspace.projection import WGS84
from skystack.airspace.xplus import XPlus, x_plus
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import LEFT, RIGHT

from .flights import (
    MODELS,
    Flights,
    TimedClearance,
    angle_between_deg,
    flights,
    geodesic_nm,
    reference,
)

HERON_SWIFT = ("HERON", "CRANE", "EGL", "MACAW", "QUAIL", "SWIFT")
SWIFT_HERON = HERON_SWIFT[::-1]
PEL_ROBIN = ("PEL", "GOOSE", "ALB", "EGL", "FINCH", "ROBIN")
PEL_SWIFT = ("PEL", "GOOSE", "ALB", "EGL", "MACAW", "QUAIL", "SWIFT")
HERON_ROBIN = ("HERON", "CRANE", "EGL", "FINCH", "ROBIN")
SWIFT_PEL = ("SWIFT", "QUAIL", "MACAW", "ALB", "GOOSE", "PEL")

HEADINGS = (
    TimedClearance(5, 0, heading_deg=35),
    TimedClearance(20, 0, heading_deg=45),
    TimedClearance(40, 0, heading_deg=205, turn=RIGHT),
    TimedClearance(3, 1, heading_deg=125),
    TimedClearance(4, 1, heading_deg=115),
    TimedClearance(100, 1, heading_deg=45),
)
MIXED = (
    TimedClearance(2, 0, heading_deg=45),
    TimedClearance(6, 0, heading_deg=225),  # exactly half a turn, once each way
    TimedClearance(30, 0, heading_deg=45),
    TimedClearance(52, 0, heading_deg=100),
    TimedClearance(54, 0, heading_deg=80),  # before the last turn is complete
    TimedClearance(60, 0, heading_deg=120, turn=LEFT),  # the long way round
    TimedClearance(70, 0, heading_deg=90),
    TimedClearance(100, 0, heading_deg=10, turn=LEFT),
    TimedClearance(4, 0, fl=340),
    TimedClearance(12, 0, fl=320),
    TimedClearance(13, 0, fl=310),  # below its level at that time
    TimedClearance(60, 0, fl=210),
    TimedClearance(110, 0, fl=300),
    TimedClearance(3, 1, fl=330),
    TimedClearance(8, 1, fl=400, heading_deg=90),
    TimedClearance(60, 1, fl=290),
    TimedClearance(3, 2, fl=420),  # above the ceiling of the table
    TimedClearance(60, 2, fl=380),
)
ROLLOUTS = {
    "headings": ((HERON_SWIFT, PEL_ROBIN), HEADINGS, False),
    "climb": ((HERON_SWIFT,), (TimedClearance(2, 0, fl=300),), True),
    "mixed": ((HERON_SWIFT, PEL_ROBIN, SWIFT_HERON), MIXED, False),
    "off the centreline": (
        (PEL_SWIFT, HERON_ROBIN, SWIFT_PEL),
        (
            TimedClearance(60, 0, fl=380),
            TimedClearance(30, 1, fl=220),
            TimedClearance(52, 1, heading_deg=90),  # in the middle of a fly-by turn
            TimedClearance(55, 2, fl=250),
        ),
        True,
    ),
}


@cache
def fly_rollout(rollout, model):
    """A rollout as flown by skystack, and as stored from BluebirdDT."""
    routes, clearances, own_navigation = ROLLOUTS[rollout]
    expected = reference("instructed.csv", rollout, model)
    sector, simulation = x_plus(), flights(model, own_navigation)
    traffic = simulation.start(
        sector.plane.to_plane(expected.lat_lon[0, :, 0], expected.lat_lon[0, :, 1]),
        expected.heading_deg[0],
        expected.fl[0],
        [sector.route_index(route) for route in routes],
        own_navigation,
    )
    return simulation.fly(traffic, int(expected.row[-1]), clearances), expected


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("rollout", ROLLOUTS)
def test_rows_agree_with_bluebird(rollout, model):
    flown, expected = fly_rollout(rollout, model)
    lat_lon = x_plus().plane.to_degrees(flown.position_nm[expected.row])
    # More deviation is allowed far from the origin.
    far = geodesic_nm(expected.lat_lon, np.zeros(2)) > 100.0
    assert np.all(geodesic_nm(lat_lon, expected.lat_lon) < np.where(far, 0.05, 0.02))
    # Own navigation may fly, and end with, slightly different bearings.
    gap = angle_between_deg(flown.heading_deg[expected.row], expected.heading_deg)
    assert np.all(gap < np.where(flown.own_navigation[0], 0.015, 0.001))
    assert flown.level_ticks[expected.row] / TICKS_PER_FL == pytest.approx(expected.fl, abs=1e-3)
    moving = expected.row > 0
    assert flown.ground_speed_kt[expected.row][moving] == pytest.approx(
        expected.ground_speed_kt[moving], abs=2e-3
    )


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("rollout", ROLLOUTS)
def test_cleared_values_appear_in_the_same_rows(rollout, model):
    flown, expected = fly_rollout(rollout, model)
    assert (
        flown.cleared_level_ticks[expected.row] / TICKS_PER_FL
    ).tolist() == expected.selected_fl.tolist()
    has_heading = ~np.isnan(expected.selected_heading_deg)
    cleared = flown.cleared_heading_deg[expected.row]
    assert cleared[has_heading].tolist() == expected.selected_heading_deg[has_heading].tolist()
    assert cleared[~has_heading].tolist() == flown.heading_deg[expected.row][~has_heading].tolist()


# The expected values below are those in the description of the rollouts, for the rows it lists.


@cache
def heading_rollout(model):
    """Two aircraft at FL300: at HERON, and 3 NM from PEL on the bearing 200."""
    sector, simulation = x_plus(), flights(model)
    lat, lon = sector.fixes["PEL"]
    lon, lat, _ = WGS84.fwd(lon, lat, 200.0, 3.0 * 1852.0)
    position = np.stack([sector.fixes_nm["HERON"], sector.plane.to_plane([lat], [lon])[0]])
    traffic = simulation.start(position, [45.19198, 134.80895])
    return simulation.fly(traffic, 300, HEADINGS)


@pytest.mark.parametrize("model", MODELS)
def test_headings_of_the_described_rollout(model):
    heading = heading_rollout(model).heading_deg
    first = {0: 45.1920, 5: 45.1920, 6: 45.1920, 7: 36.1920, 8: 35.0, 20: 35.0, 21: 35.0}
    first |= {22: 44.0, 23: 45.0, 41: 45.0, 42: 54.0, 43: 63.0, 50: 126.0, 58: 198.0, 59: 205.0}
    first |= {60: 205.0, 300: 205.0}
    second = {0: 134.80895, 4: 134.80895, 5: 125.80895, 6: 116.80895, 7: 115.0, 101: 115.0}
    second |= {102: 106.0, 103: 97.0, 108: 52.0, 109: 45.0, 300: 45.0}
    for aircraft, rows in enumerate((first, second)):
        assert heading[list(rows), aircraft] == pytest.approx(list(rows.values()), abs=1e-3)


@pytest.mark.parametrize(
    ("model", "first", "second"),
    [
        ("constant", (-2.591542109, -1.130081790), (1.632091695, 1.918770306)),
        ("table", (-2.950759395, -1.248507504), (1.802074, 2.344787)),
    ],
)
def test_last_positions_of_the_described_rollout(model, first, second):
    end = x_plus().plane.to_degrees(heading_rollout(model).position_nm[300])
    assert np.all(geodesic_nm(end, [first, second]) < 0.05)


@pytest.mark.parametrize(
    ("model", "levels_fl"),
    [
        ("constant", {2: 100.0, 3: 100.0, 4: 102.0, 102: 298.0, 103: 300.0, 120: 300.0}),
        ("table", {2: 100.0, 3: 100.0, 4: 102.5, 82: 297.5, 83: 300.0, 120: 300.0}),
    ],
)
def test_levels_of_the_described_climb(model, levels_fl):
    sector = XPlus(levels_fl=(100, 300)).sector()
    simulation = Flights(sector, model, own_navigation=True)
    route = sector.route_index(HERON_SWIFT)
    traffic = simulation.start([sector.fixes_nm["HERON"]], 45.19198, 100.0, [route], True)
    flown = simulation.fly(traffic, 120, [TimedClearance(2, 0, fl=300)])
    levels = flown.level_ticks[list(levels_fl), 0] / TICKS_PER_FL
    assert levels == pytest.approx(list(levels_fl.values()), abs=1e-3)
    assert (flown.cleared_level_ticks[[2, 3], 0] / TICKS_PER_FL).tolist() == [100.0, 300.0]
    if model == "table":
        # A ground speed while climbing: 2,500 ft/min are 24.686 kt.
        airspeed = np.hypot(flown.ground_speed_kt[[4, 83, 84], 0], [24.685, 24.685, 0.0])
        assert airspeed == pytest.approx([291.49, 451.416, 465.9408], abs=0.01)
        assert flown.ground_speed_kt[83, 0] == pytest.approx(450.741, abs=1e-3)
