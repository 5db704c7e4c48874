"""BlueSky scenario files: the commands of a scenario, their times and what cannot be said."""

import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.platforms.bluesky_scenario import (
    SUBSTITUTES,
    flown_type,
    scenario_text,
    selected_speed,
)
from skystack.simulator.performance import (
    PERFORMANCE,
    TICKS_PER_FL,
    performance,
    tas_from_cas,
    tas_from_mach,
)
from skystack.simulator.scenario_file import Aircraft, GivenClearance, Scenario


def scenario(*clearances, own_navigation=False, callsign="BAW12", cycles=20):
    sector = x_plus()
    route = next(route for route in sector.routes if route[0] == sector.routes[0][0])
    lat, lon = sector.fixes[route[0]]
    one = Aircraft(callsign, "B753", route, lat, lon, 300.0, 45.19, 300, own_navigation)
    return Scenario(sector, "table", cycles, (one,), clearances)


def lines(flown):
    """Time [s] and command of every line."""
    found = []
    for line in scenario_text(flown).splitlines():
        hours, minutes, seconds, command = re.fullmatch(
            r"(\d\d):(\d\d):(\d\d)\.00>(.+)", line
        ).groups()
        found.append((3600 * int(hours) + 60 * int(minutes) + int(seconds), command))
    return found


def test_aircraft_are_created_at_the_start():
    flown = scenario()
    one = flown.aircraft[0]
    (_, step), (time_s, create), *_ = lines(flown)
    assert step == "DT 1"
    assert time_s == 0
    word, callsign, aircraft_type, *numbers, speed = create.split()
    assert (word, callsign, aircraft_type) == ("CRE", "BAW12", "B752")
    assert [float(number) for number in numbers] == pytest.approx(
        [one.lat, one.lon, 45.19, 30000.0], abs=1e-9
    )
    assert float(speed) == 300.0


def test_clearances_stand_at_the_time_of_their_cycle():
    flown = scenario(
        GivenClearance(700, "BAW12", heading_deg=360),
        GivenClearance(5, "BAW12", heading_deg=90, fl=340),
        GivenClearance(5, "BAW12", heading_deg=35),
        cycles=1000,
    )
    told = [entry for entry in lines(flown) if entry[0] > 0]
    assert told == [
        (30, "HDG BAW12 035"),
        (30, "ALT BAW12 FL340"),
        (30, "VS BAW12 2500.000000"),
        # The climb of 40 levels: its speed, its Mach number from the crossover on, and cruise.
        (30, "SPD BAW12 290.000000"),
        (72, "SPD BAW12 M0.79000000"),
        (132, "SPD BAW12 M0.80000000"),
        (4200, "HDG BAW12 000"),
        (6000, "HOLD"),
    ]


def test_a_file_is_in_the_order_of_time():
    flown = scenario(*(GivenClearance(cycle, "BAW12", fl=310) for cycle in (9, 3, 0)))
    times = [time_s for time_s, _ in lines(flown)]
    assert times == sorted(times)


def test_own_navigation_is_told_the_fixes_after_the_first():
    flown = scenario(own_navigation=True)
    told = [command.split() for _, command in lines(flown)]
    waypoints = [tuple(map(float, words[2:])) for words in told if words[0] == "ADDWPT"]
    fixes = [flown.sector.fixes[name] for name in flown.aircraft[0].route[1:]]
    np.testing.assert_allclose(waypoints, fixes, rtol=0.0, atol=1e-9)
    assert ["LNAV", "BAW12", "ON"] in told


def test_without_own_navigation_no_route_is_told():
    assert not any(command.startswith(("ADDWPT", "LNAV")) for _, command in lines(scenario()))


@pytest.mark.parametrize("callsign", ["baw12", "BAW 12", "BAW,1", "B;DEL", "ÄÖ1", "AC1#"])
def test_a_callsign_that_bluesky_cannot_say_is_refused(callsign):
    with pytest.raises(InputError, match="capital letters and digits") as refused:
        scenario_text(scenario(callsign=callsign))
    assert repr(callsign) in str(refused.value)


@pytest.mark.parametrize("flown_as", ["XXXX", "B752\n00:00:00.00>QUIT", "b752", ""])
def test_a_type_that_bluesky_would_replace_is_refused(flown_as):
    first = replace(scenario().aircraft[0], type=flown_as)
    with pytest.raises(InputError, match=r"unknown to BlueSky .*as B752"):
        scenario_text(replace(scenario(), aircraft=(first,)))


@pytest.mark.parametrize("turn", ["left", "right"])
def test_a_direction_of_turn_is_refused(turn):
    given = GivenClearance(5, "BAW12", heading_deg=90, turn=turn)
    with pytest.raises(InputError, match=f"'{turn}' in cycle 5 for BAW12"):
        scenario_text(scenario(given))
    free = replace(scenario(), clearances=(GivenClearance(5, "BAW12", 90, "shortest"),))
    assert "HDG BAW12 090" in scenario_text(free)


@pytest.mark.parametrize("name", PERFORMANCE)
@pytest.mark.parametrize("fl", [50, 100, 120, 150, 200, 300, 306, 310, 360, 400])
def test_the_selected_speed_is_that_of_cruise(name, fl):
    text = selected_speed(performance(name), float(fl))
    level = np.array([float(fl)])
    if text.startswith("M"):
        flown = tas_from_mach(level, float(text[1:]))
    else:
        flown = tas_from_cas(level, np.array([float(text)]))
    ticks = jnp.array([fl * TICKS_PER_FL], dtype=jnp.float32)
    cruise = performance(name).true_airspeed_kt(ticks, jnp.zeros(1))
    np.testing.assert_allclose(flown, cruise, rtol=2e-6)


def test_the_table_changes_from_airspeed_to_mach_number():
    assert float(selected_speed(performance("table"), 300.0)) == 300.0
    assert float(selected_speed(performance("table"), 100.0)) == 250.0
    assert float(selected_speed(performance("table"), 340.0).removeprefix("M")) == 0.8


def test_another_type_is_flown_only_where_it_is_said():
    assert flown_type("A320") == "A320"
    assert flown_type("B753") == SUBSTITUTES["B753"] == "B752"
