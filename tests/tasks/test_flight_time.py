"""Flight times of routes in cycles, against pyproj and against simulated flights."""

import math

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest

from skystack.airspace.projection import METRES_PER_NM, WGS84
from skystack.airspace.sector_file import SectorEntry
from skystack.errors import InputError
from skystack.learning.experiment import experiment_names, load_experiment
from skystack.simulator.fleet import AircraftType
from skystack.simulator.performance import PERFORMANCE, TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S
from skystack.tasks.flight_time import flight_times
from skystack.tasks.registry import build_task, check_cycles
from skystack.tasks.settings import NavigationSettings

# 59 N to 66 N: 7.2 degrees of the meridian from SOUTO to the exit, 8.4 of a parallel from WESTO.
NORTH = msgspec.convert(
    {
        "name": "north",
        "levels_fl": [200, 400],
        "area": {"type": "Polygon", "coordinates": [[[11, 59], [19, 59], [19, 66], [11, 66]]]},
        "fixes": {
            "SOUTO": {"lat": 58.8, "lon": 15},
            "MIDDL": {"lat": 62.5, "lon": 15},
            "NORTH": {"lat": 66, "lon": 15},
            "NORTO": {"lat": 66.2, "lon": 15},
            "WESTO": {"lat": 65.8, "lon": 10.6},
            "EASTE": {"lat": 65.8, "lon": 19},
            "EASTO": {"lat": 65.8, "lon": 19.4},
        },
        "routes": [["SOUTO", "MIDDL", "NORTH", "NORTO"], ["WESTO", "EASTE", "EASTO"]],
    },
    SectorEntry,
)
SOUTH_TO_NORTH_NM = WGS84.inv(15.0, 58.8, 15.0, 66.0)[2] / METRES_PER_NM
WEST_TO_EAST_NM = WGS84.inv(10.6, 65.8, 19.0, 65.8)[2] / METRES_PER_NM
MACH_080_AT_FL300_KT = 465.94  # as BluebirdDT flies the B753
SLOW = AircraftType(
    type="AT76", low_cas_kt=(160.0, 170.0, 180.0), high_cas_kt=(160.0, 170.0, 180.0),
    mach=(0.4, 0.44, 0.42), rate_ft_min=1200.0, ceiling_fl=310.0,
)  # fmt: skip


def cycles(distance_nm, speed_kt):
    return math.ceil(distance_nm / speed_kt * 3600.0 / CYCLE_S)


def task(name="lateral", **changes):
    settings = load_experiment(name).task
    return build_task(msgspec.structs.replace(settings, sector=NORTH, **changes))


def test_flight_times_are_those_of_geodesics_less_the_disc():
    found = flight_times(task(cycles=600).simulator, (300,), disc_nm=4.0)
    assert found.fastest_kt == found.slowest_kt == pytest.approx(MACH_080_AT_FL300_KT, abs=0.01)
    expected = [
        cycles(length_nm - 4.0, MACH_080_AT_FL300_KT)
        for length_nm in (SOUTH_TO_NORTH_NM, WEST_TO_EAST_NM)
    ]
    assert found.fastest.tolist() == found.slowest.tolist() == expected
    assert found.shortest == 1
    assert flight_times(task(cycles=600).simulator, (300,), 5000.0).fastest.tolist() == [1, 1]


@pytest.mark.slow
def test_own_navigation_takes_the_predicted_time():
    """In the vertical task, which starts at the first fix of the route."""
    vertical = task("vertical", cycles=600, levels_fl=(300, 310))
    expected = flight_times(vertical.simulator, (300,), disc_nm=0.0)
    step = jax.jit(lambda state: vertical.step(state, jnp.asarray(0, dtype=jnp.int32))[0])
    keys = (jax.random.key(number) for number in range(100))
    drawn = (vertical.scenarios.draw(key) for key in keys)
    first = next(each for each in drawn if each.traffic.route == 1 and
                 each.traffic.level_ticks == 300 * TICKS_PER_FL)  # fmt: skip
    state, count = vertical.begin(first.traffic, first.exit_level_ticks), 0
    while bool(state.traffic.active[0]) and count < 600:
        state, count = step(state), count + 1
    assert bool(state.memory.progress.exited[0])
    assert count == pytest.approx(expected.fastest[1], abs=1)


def test_fastest_and_slowest_of_several_types_and_levels():
    mixed = task(fleet=(AircraftType(), SLOW), level_fl=(300, 310), cycles=2000)
    found = flight_times(mixed.simulator, (300, 310), disc_nm=4.0)
    speeds = [
        float(mixed.simulator.level_ground_speed_kt(jnp.array([level * TICKS_PER_FL]), kind)[0])
        for level in (300.0, 310.0)
        for kind in (jnp.array([0], dtype=jnp.int32), jnp.array([1], dtype=jnp.int32))
    ]
    assert found.fastest_kt == pytest.approx(max(speeds), rel=1e-6)
    assert found.slowest_kt == pytest.approx(min(speeds), rel=1e-6)
    assert found.slowest[0] == cycles(SOUTH_TO_NORTH_NM - 4.0, min(speeds))
    assert found.fastest[0] == cycles(SOUTH_TO_NORTH_NM - 4.0, max(speeds))


@pytest.mark.parametrize("name", PERFORMANCE)
def test_planned_speeds_are_the_flown_speeds(name):
    model, levels = PERFORMANCE[name], np.array([0.0, 95.0, 120.5, 300.0, 400.0])
    ticks = jnp.asarray(levels * TICKS_PER_FL, dtype=jnp.float32)
    flown = model.true_airspeed_kt(ticks, jnp.zeros_like(ticks))
    assert np.allclose(model.cruise_kt(levels), flown[None], rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "levels", "disc_nm"), [("lateral", (300,), 4.0), ("vertical", (300, 310), 0.0)]
)
def test_refuses_a_sector_whose_shortest_route_takes_longer(name, levels, disc_nm):
    """Traffic is at FL300 in `lateral`, at every level of the sector in `vertical`."""
    settings = {"levels_fl": (300, 310)}
    times = flight_times(task(name, cycles=600, **settings).simulator, levels, disc_nm)
    needed = int(times.fastest[1])
    check_cycles(task(name, cycles=needed, **settings))
    with pytest.raises(InputError) as error:
        check_cycles(task(name, cycles=needed - 1, **settings))
    assert str(error.value) == (
        f"task.cycles is {needed - 1}, but the shortest route of north, WESTO EASTE EASTO, takes "
        f"{needed} at {times.fastest_kt:.0f} kt (allowed: {needed} to 10000; set it with "
        "--cycles, or task.cycles in the TOML)"
    )


def test_notice_counts_the_routes_that_take_longer():
    needed = cycles(SOUTH_TO_NORTH_NM - 4.0, MACH_080_AT_FL300_KT)
    expected = f"1 of 2 routes take more than 300 cycles: {needed} at 466 kt (see --cycles)"
    assert check_cycles(task()) == expected
    assert len(expected) <= 80
    assert check_cycles(task(cycles=needed - 1)) is not None
    assert check_cycles(task(cycles=needed)) is None
    # The slowest type decides.
    mixed = check_cycles(task(fleet=(AircraftType(), SLOW), cycles=needed))
    assert mixed.startswith(f"1 of 2 routes take more than {needed} cycles: ")


@pytest.mark.parametrize("name", experiment_names())
def test_shipped_experiments_have_enough_cycles_for_all_routes(name):
    assert check_cycles(build_task(load_experiment(name).task)) is None


def test_limit_of_cycles():
    assert msgspec.convert({"cycles": 10_000}, NavigationSettings).cycles == 10_000
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"cycles": 10_001}, NavigationSettings)


def test_an_exit_before_the_fix_shortens_all_routes():
    """20 NM at 465.94 kt are 25.8 cycles."""
    whole, shorter = (
        flight_times(
            build_task(NavigationSettings(exit_before_nm=before_nm)).simulator, (300,), 4.0
        )
        for before_nm in (0.0, 20.0)
    )
    assert set(whole.fastest - shorter.fastest) <= {25, 26}
