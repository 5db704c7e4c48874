"""Own navigation against BluebirdDT: every route of X-Plus, and turns too sharp to be flown."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest

from skystack.airspace.geometry import distance_right_of_route, inside_area
from skystack.airspace.sector import Sector
from skystack.airspace.xplus import x_plus
from skystack.simulator.performance import TICKS_PER_FL

from .flights import (
    MODELS,
    Flights,
    TimedClearance,
    angle_between_deg,
    flights,
    geodesic_nm,
    reference,
)

ROUTES = [" ".join(route) for route in x_plus().routes]
STRAIGHT = ("HERON CRANE EGL MACAW QUAIL SWIFT", "SWIFT QUAIL MACAW EGL CRANE HERON")
CYCLES = 200

SHARP = Sector(
    name="sharp turns",
    origin=(0.0, 0.0),
    area=((-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)),
    levels_fl=(100, 400),
    fixes={
        "ALFA": (-0.5, 0.0),
        "BRAVO": (0.0, 0.0),
        "DELTA": (-0.1277, 0.1071),
        "ECHO": (-0.1879, 0.0684),
        "FOXTROT": (-0.4924, 0.0868),
        "HOTEL": (0.0, -0.0417),
    },
    routes=tuple(("ALFA", "BRAVO", end) for end in ("DELTA", "ECHO", "FOXTROT", "HOTEL")),
)
"""Turns of 140, 160, 170 and -90 degrees onto last legs that are too short for them."""


@cache
def all_routes(sector_name, model):
    """All routes of a sector, each flown from its first fix at FL300."""
    simulation = Flights(SHARP, model, True) if sector_name == "sharp" else flights(model, True)
    table = simulation.simulator.sector.route_table
    n = len(table.last_fix)
    traffic = simulation.start(
        table.fixes_nm[:, 0], table.first_heading_deg, 300.0, range(n), own_navigation=True
    )
    return simulation.fly(traffic, CYCLES)


def assert_agrees(flown, index, expected):
    plane = x_plus().plane
    assert geodesic_nm(plane.to_degrees(flown.position_nm[0, index]), expected.lat_lon[0, 0]) < 1e-4
    apart = geodesic_nm(
        plane.to_degrees(flown.position_nm[expected.row, index]), expected.lat_lon[:, 0]
    )
    far = geodesic_nm(expected.lat_lon[:, 0], np.zeros(2)) > 100.0
    assert np.all(apart < np.where(far, 0.05, 0.02))
    gap = angle_between_deg(flown.heading_deg[expected.row, index], expected.heading_deg[:, 0])
    assert np.all(gap < 0.015)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("route", ROUTES)
def test_flies_routes_like_bluebird(route, model):
    flown = all_routes("x-plus", model)
    assert_agrees(flown, ROUTES.index(route), reference("own_navigation.csv", route, model))


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("index", range(len(SHARP.routes)))
def test_flies_routes_that_end_in_a_turn_like_bluebird(index, model):
    """The turn is completed at the standard rate, to the bearing last steered to."""
    flown = all_routes("sharp", model)
    assert_agrees(
        flown, index, reference("own_navigation.csv", " ".join(SHARP.routes[index]), model)
    )


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("route", ROUTES)
def test_stays_near_the_centreline_inside_the_sector(route, model):
    """Fly-by turns cut corners by 0.3 to 1.14 NM, or at most 1.49 NM with the table."""
    flown, index = all_routes("x-plus", model), ROUTES.index(route)
    path = jnp.asarray(flown.position_nm[:, index])
    fixes = x_plus().route_table.fixes_nm[index]
    inside = inside_area(path, x_plus().area_nm)
    route_nm = [jnp.broadcast_to(fix, path.shape) for fix in fixes]
    right = distance_right_of_route(path, route_nm)
    largest = float(np.max(np.abs(np.asarray(right)[np.asarray(inside)])))
    if route in STRAIGHT:
        assert largest < 0.01
    else:
        assert 0.25 < largest < {"constant": 1.15, "table": 1.5}[model]


LEAVES_IN_ROW = {
    "ROBIN FINCH EGL CRANE HERON": (120, 103),
    "ROBIN FINCH EGL ALB GOOSE PEL": (150, 129),
    "HERON CRANE EGL MACAW QUAIL SWIFT": (143, 123),
    "HERON CRANE EGL FINCH ROBIN": (120, 103),
    "PEL GOOSE ALB MACAW QUAIL SWIFT": (154, 132),
    "PEL GOOSE ALB EGL MACAW QUAIL SWIFT": (170, 146),
    "PEL GOOSE ALB EGL FINCH ROBIN": (150, 129),
    "SWIFT QUAIL MACAW EGL CRANE HERON": (143, 123),
    "SWIFT QUAIL MACAW EGL ALB GOOSE PEL": (170, 145),
    "SWIFT QUAIL MACAW ALB GOOSE PEL": (154, 132),
}
"""The first row outside again in BluebirdDT, at constant speed and with the table."""


@pytest.mark.parametrize(("model", "enters_in_row"), [("constant", 8), ("table", 7)])
@pytest.mark.parametrize("route", ROUTES)
def test_rows_inside_the_sector(route, model, enters_in_row):
    path = jnp.asarray(all_routes("x-plus", model).position_nm[:, ROUTES.index(route)])
    inside = np.flatnonzero(np.asarray(inside_area(path, x_plus().area_nm)))
    leaves_in_row = LEAVES_IN_ROW[route][MODELS.index(model)]
    assert inside.tolist() == list(range(enters_in_row, leaves_in_row))


@pytest.mark.parametrize("model", MODELS)
def test_ends_near_the_last_fix_and_holds_the_heading(model):
    flown = all_routes("x-plus", model)
    table = x_plus().route_table
    end_nm = {"constant": 2.0, "table": 0.5}[model]
    one_second_nm = 0.13
    for index, last in enumerate(table.last_fix):
        own = flown.own_navigation[:, index]
        ended = int(np.argmin(own))
        assert own[:ended].all()
        assert not own[ended:].any()
        assert flown.next_fix[ended, index] == last
        before, after = flown.position_nm[[ended - 1, ended], index]
        distances = np.linalg.norm(table.fixes_nm[index, last] - [before, after], axis=1)
        assert distances[0] > end_nm - one_second_nm
        assert distances[1] < end_nm
        assert len(set(flown.heading_deg[ended:, index].tolist())) == 1
        assert (flown.cleared_heading_deg[ended:, index] == flown.heading_deg[ended:, index]).all()


def test_fixes_are_passed_in_order():
    flown = all_routes("x-plus", "table")
    steps = np.diff(flown.next_fix, axis=0)
    assert flown.next_fix[0].tolist() == [1] * len(ROUTES)
    assert set(np.unique(steps)) == {0, 1}


def one_aircraft(own_navigation, clearances, route="HERON CRANE EGL FINCH ROBIN", cycles=60):
    sector, simulation = x_plus(), flights("table", True)
    index = ROUTES.index(route)
    start_nm = sector.route_table.fixes_nm[index, :1]
    heading = sector.route_table.first_heading_deg[index]
    traffic = simulation.start(start_nm, heading, 300.0, [index], own_navigation)
    return simulation.fly(traffic, cycles, clearances)


def test_an_adopted_heading_ends_own_navigation():
    flown = one_aircraft(True, [TimedClearance(10, 0, heading_deg=90)])
    own = flown.own_navigation[:, 0]
    assert own[:11].all()
    assert not own[11:].any()
    assert flown.cleared_heading_deg[11, 0] == 90.0
    assert flown.heading_deg[11, 0] == pytest.approx(45.19, abs=0.05)
    assert flown.heading_deg[12, 0] == pytest.approx(flown.heading_deg[11, 0] + 9.0, abs=1e-4)
    assert (flown.heading_deg[16:, 0] == 90.0).all()


def test_a_level_does_not_end_own_navigation():
    flown = one_aircraft(True, [TimedClearance(10, 0, fl=350)])
    assert flown.own_navigation.all()
    assert flown.level_ticks[-1, 0] == 350.0 * TICKS_PER_FL
    # The turn towards FINCH has been flown.
    assert flown.next_fix[-1, 0] == 3
    assert flown.heading_deg[-1, 0] == pytest.approx(104.9, abs=0.1)


def test_the_cleared_heading_follows_the_flown_heading():
    flown = one_aircraft(True, [])
    assert (flown.cleared_heading_deg == flown.heading_deg).all()


def test_a_heading_during_a_fly_by_turn_uses_the_standard_rate():
    """The radius of the fly-by turn is dropped when own navigation ends."""
    flown = one_aircraft(True, [TimedClearance(42, 0, heading_deg=300)])
    assert flown.turn_radius_nm[42, 0] > 0.0
    turning = flown.heading_deg[44:54, 0]
    assert angle_between_deg(turning[1:], turning[:-1]) == pytest.approx(9.0, abs=1e-3)


def test_does_not_follow_the_route_without_own_navigation():
    free = one_aircraft(False, [TimedClearance(10, 0, heading_deg=50)])
    assert not free.own_navigation.any()
    sector = x_plus()
    index = ROUTES.index("HERON CRANE EGL FINCH ROBIN")
    plain = flights("table", False)
    traffic = plain.start(
        sector.route_table.fixes_nm[index, :1],
        sector.route_table.first_heading_deg[index],
        300.0,
        [index],
    )
    same = plain.fly(traffic, 60, [TimedClearance(10, 0, heading_deg=50)])
    assert free.heading_deg.tolist() == same.heading_deg.tolist()
    assert free.position_nm == pytest.approx(same.position_nm, abs=1e-4)
