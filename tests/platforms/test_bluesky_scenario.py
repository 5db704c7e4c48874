"""BlueSky scenario files: commands, their times, and what cannot be expressed."""

import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.platforms.bluesky_scenario import (
    SUBSTITUTES,
    check_flown_types,
    flown_type,
    levels_fl,
    phase_of,
    scenario_text,
    selected_speed,
)
from skystack.simulator.fleet import AircraftType
from skystack.simulator.performance import (
    PERFORMANCE,
    TICKS_PER_FL,
    performance,
    tas_from_cas,
    tas_from_mach,
)
from skystack.simulator.scenario_file import Aircraft, Scenario, ScheduledClearance


def scenario(*clearances, own_navigation=False, callsign="BAW12", cycles=20):
    sector = x_plus()
    route = next(route for route in sector.routes if route[0] == sector.routes[0][0])
    lat, lon = sector.fixes[route[0]]
    one = Aircraft(callsign, "B753", route, lat, lon, 300.0, 45.19, 300, own_navigation)
    return Scenario(sector, "table", cycles, (one,), clearances)


def lines(flown):
    """The time [s] and the command of every line."""
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


def test_clearances_have_the_time_of_their_cycle():
    flown = scenario(
        ScheduledClearance(700, "BAW12", heading_deg=360),
        ScheduledClearance(5, "BAW12", heading_deg=90, fl=340),
        ScheduledClearance(5, "BAW12", heading_deg=35),
        cycles=1000,
    )
    later = [entry for entry in lines(flown) if entry[0] > 0]
    assert later == [
        (30, "HDG BAW12 035"),
        (30, "ALT BAW12 FL340"),
        (30, "VS BAW12 2500.000000"),
        # The climb of 40 levels: climb airspeed, climb Mach number from the crossover, cruise.
        (30, "SPD BAW12 290.000000"),
        (72, "SPD BAW12 M0.79000000"),
        (132, "SPD BAW12 M0.80000000"),
        (4200, "HDG BAW12 000"),
        (6000, "HOLD"),
    ]


def test_lines_are_in_order_of_time():
    flown = scenario(*(ScheduledClearance(cycle, "BAW12", fl=310) for cycle in (9, 3, 0)))
    times = [time_s for time_s, _ in lines(flown)]
    assert times == sorted(times)


def test_own_navigation_gets_all_fixes_but_the_first():
    flown = scenario(own_navigation=True)
    commands = [command.split() for _, command in lines(flown)]
    waypoints = [tuple(map(float, words[2:])) for words in commands if words[0] == "ADDWPT"]
    fixes = [flown.sector.fixes[name] for name in flown.aircraft[0].route[1:]]
    np.testing.assert_allclose(waypoints, fixes, rtol=0.0, atol=1e-9)
    assert ["LNAV", "BAW12", "ON"] in commands


def test_direct_to_a_fix_replaces_the_route_by_the_rest():
    flown = scenario(ScheduledClearance(5, "BAW12", direct_to="EGL"))
    route = flown.aircraft[0].route
    commands = [command for time_s, command in lines(flown) if time_s == 30]
    points = [flown.sector.fixes[name] for name in route[route.index("EGL") :]]
    assert commands[0] == "DELRTE BAW12"
    assert commands[-1] == "LNAV BAW12 ON"
    added = [[float(number) for number in line.split()[2:]] for line in commands[1:-1]]
    np.testing.assert_allclose(added, points, atol=1e-9)


def test_without_own_navigation_there_is_no_route():
    assert not any(command.startswith(("ADDWPT", "LNAV")) for _, command in lines(scenario()))


@pytest.mark.parametrize("callsign", ["baw12", "BAW 12", "BAW,1", "B;DEL", "ÄÖ1", "AC1#"])
def test_rejects_callsigns_that_bluesky_cannot_parse(callsign):
    with pytest.raises(InputError, match="capital letters and digits") as error:
        scenario_text(scenario(callsign=callsign))
    assert repr(callsign) in str(error.value)


@pytest.mark.parametrize("flown_as", ["XXXX", "B752\n00:00:00.00>QUIT", "b752", ""])
def test_rejects_types_that_bluesky_would_replace(flown_as):
    first = replace(scenario().aircraft[0], type=flown_as)
    with pytest.raises(InputError, match=r"unknown to BlueSky .*as B752"):
        scenario_text(replace(scenario(), aircraft=(first,)))


@pytest.mark.parametrize("turn", ["left", "right"])
def test_rejects_directions_of_turn(turn):
    given = ScheduledClearance(5, "BAW12", heading_deg=90, turn=turn)
    with pytest.raises(InputError, match=f"'{turn}' in cycle 5 for BAW12"):
        scenario_text(scenario(given))
    shortest = replace(scenario(), clearances=(ScheduledClearance(5, "BAW12", 90, "shortest"),))
    assert "HDG BAW12 090" in scenario_text(shortest)


@pytest.mark.parametrize("name", PERFORMANCE)
@pytest.mark.parametrize("fl", [50, 100, 120, 150, 200, 300, 306, 310, 360, 400])
def test_selected_speed_is_the_cruise_speed(name, fl):
    text = selected_speed(performance(name), float(fl))
    level = np.array([float(fl)])
    if text.startswith("M"):
        flown = tas_from_mach(level, float(text[1:]))
    else:
        flown = tas_from_cas(level, np.array([float(text)]))
    ticks = jnp.array([fl * TICKS_PER_FL], dtype=jnp.float32)
    cruise = performance(name).true_airspeed_kt(ticks, jnp.zeros(1))
    np.testing.assert_allclose(flown, cruise, rtol=2e-6)


def test_table_changes_from_airspeed_to_mach_number():
    assert selected_speed(performance("table"), 300) == selected_speed(performance("table"), 300.0)
    assert float(selected_speed(performance("table"), 300.0)) == 300.0
    assert float(selected_speed(performance("table"), 100.0)) == 250.0
    assert float(selected_speed(performance("table"), 340.0).removeprefix("M")) == 0.8


def test_substitutes_only_listed_types():
    assert flown_type("A320") == "A320"
    assert flown_type("B753") == SUBSTITUTES["B753"] == "B752"


def test_climbs_accelerate_and_capture_levels_like_bluesky():
    """3,000 ft/min is 0.5 levels per second, reached in steps of 0.05: 0.05, 0.10, ... The level is
    captured when it is at most 1.05 seconds away, here 0.525 levels."""
    gain_fl = np.concatenate([np.arange(1, 11) * 0.05, np.full(40, 0.5)])
    fl_each_second = 300.0 + np.cumsum(gain_fl)
    captured = int(np.flatnonzero(310.0 - fl_each_second <= 1.05 * 0.5)[0])
    fl_each_second[captured + 1 :] = 310.0
    found = list(levels_fl(300.0, {1: 310}, 8, 3000.0))
    assert [selected for _, selected in found] == [300.0] + [310.0] * 7
    expected = [300.0, 300.0, *fl_each_second[5::6]][:8]
    assert [fl for fl, _ in found] == pytest.approx(expected, abs=1e-9)
    assert found[-1][0] == 310.0


def test_captures_levels_that_are_less_than_1_05_s_away():
    """After 23 s at 3,000 ft/min, 0.51 levels remain: more than 1 s, less than 1.05 s."""
    found = [fl for fl, _ in levels_fl(300.24, {0: 310}, 5, 3000.0)]
    assert found == pytest.approx([300.24, 301.29, 303.99, 306.99, 310.0], abs=1e-9)


def test_descents_mirror_climbs():
    climbs, down = (list(levels_fl(300.0, {1: to}, 9, 2500.0)) for to in (320, 280))
    assert [fl - 300.0 for fl, _ in climbs] == pytest.approx([300.0 - fl for fl, _ in down])
    assert min(fl for fl, _ in down) > 280.0


def test_slow_climbs_reach_their_rate_at_once():
    """300 ft/min is 0.05 levels per second, or 0.3 per cycle, the greatest change in one second. A
    reversal takes one second at zero rate."""
    found = [fl for fl, _ in levels_fl(300.0, {0: 301, 2: 300}, 4, 300.0)]
    assert found == pytest.approx([300.0, 300.3, 300.6, 300.35], abs=1e-9)


def test_holds_the_level_without_a_clearance():
    assert list(levels_fl(300.9, {}, 3, 2500.0)) == [(300.9, 300.9)] * 3


def test_each_aircraft_has_its_own_speeds_and_rates():
    """One aircraft of each type is cleared to climb, a third one is not cleared."""
    kinds = (
        AircraftType("A320", mach=(0.5, 0.6, 0.7), rate_ft_min=1200.0),
        AircraftType("AT76", mach=(0.3, 0.4, 0.45), rate_ft_min=600.0),
    )
    one = scenario().aircraft[0]
    flying = tuple(
        replace(one, callsign=callsign, type=kind, fl=350.0)
        for callsign, kind in (("A", "A320"), ("B", "AT76"), ("C", "AT76"))
    )
    climbs = tuple(ScheduledClearance(2, callsign, fl=360) for callsign in ("A", "B"))
    timed = lines(replace(scenario(*climbs), aircraft=flying, fleet=kinds))
    assert [command for time_s, command in timed if time_s == 0 and "SPD" in command] == [
        "SPD A M0.60000000",
        "SPD B M0.40000000",
        "SPD C M0.40000000",
    ]
    assert [command for time_s, command in timed if time_s == 12] == [
        "ALT A FL360",
        "VS A 1200.000000",
        "ALT B FL360",
        "VS B 600.000000",
        "SPD A M0.50000000",
        "SPD B M0.30000000",
    ]
    # Ten levels at 0.2 and 0.1 per second, and the acceleration: A climbs for 51 s, B for 101 s.
    assert [entry for entry in timed if entry[0] > 12] == [
        (66, "SPD A M0.60000000"),
        (114, "SPD B M0.40000000"),
        (120, "HOLD"),
    ]


def test_phases_of_flight():
    assert [phase_of(300.0, selected) for selected in (300.0, 300.1, 299.9)] == [0, 1, -1]


def test_fleet_has_a_type_or_its_substitute_but_not_both():
    one = scenario().aircraft[0]
    for kind in ("B753", "B752"):
        flown = replace(scenario(), aircraft=(replace(one, type=kind),))
        check_flown_types(replace(flown, fleet=(AircraftType(kind),)))
    with pytest.raises(InputError, match="has B753, which BlueSky flies as B752, and B752 itself"):
        check_flown_types(replace(flown, fleet=(AircraftType("B752"), AircraftType("B753"))))


@pytest.mark.parametrize(("cycles", "ends"), [(9, "00:00:54.00"), (10_000, "16:40:00.00")])
def test_a_file_ends_with_the_last_cycle(cycles, ends):
    assert scenario_text(scenario(cycles=cycles)).endswith(f"\n{ends}>HOLD\n")
