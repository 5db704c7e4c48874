"""The memory of a task: progress along routes, exits, separation, counts of instructions."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.airspace.projection import METRES_PER_NM, WGS84
from skystack.airspace.sector import Sector
from skystack.airspace.xplus import x_plus
from skystack.simulator.crowd import Crowd
from skystack.simulator.generator import LateralScenarios
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import start, ticks
from skystack.tasks import progress as progress_module
from skystack.tasks.features import centreline_distance, distance_in_hand, next_fix_distance
from skystack.tasks.progress import ProgressTracker
from skystack.tasks.tracking import Tracker
from tests.sectors import FAR_NORTH
from tests.tasks.memories import with_fields

SQUARE = ((-1.2, -1.2), (-1.2, 1.2), (1.2, 1.2), (1.2, -1.2))
HAIRPIN = Sector(
    "hairpin",
    (0.0, 0.0),
    SQUARE,
    (200, 400),
    {
        "WO": (0.0, -1.35),
        "S1": (0.0, 0.3),
        "S2": (0.02, -0.3),
        "S3": (0.04, 0.3),
        "EE": (0.0, 1.2),
        "EO": (0.0, 1.35),
    },
    (("WO", "S1", "S2", "S3", "EE", "EO"),),
)


def traffic_at(sector, points_deg, route=0, heading_deg=90.0):
    """Aircraft at points (lat, lon) on a route."""
    count = len(points_deg)
    position = sector.plane.to_plane(*np.array(points_deg).T)
    return start(
        jnp.asarray(position, dtype=jnp.float32),
        jnp.full(count, heading_deg),
        jnp.full(count, ticks(300.0), dtype=jnp.float32),
        jnp.full(count, route, dtype=jnp.int32),
        jnp.full(count, 466.0),
        jnp.zeros(count, dtype=bool),
    )


def next_fixes(sector, points_deg):
    """The next fix of an aircraft after each of the points, which it passes one per cycle."""
    tracker, found = Tracker(sector), []
    track, memory = jax.jit(tracker.track), None
    for point in points_deg:
        traffic = traffic_at(sector, [point])
        memory = tracker.begin(traffic, traffic.level_ticks) if memory is None else memory
        memory = track(memory, traffic)
        found.append(int(memory.progress.next_fix[0]))
    return found


@pytest.mark.slow
def test_starts_of_a_hairpin_route_are_before_its_second_fix():
    """The bisector of a hairpin's legs also crosses the leg to it, 99 NM before the fix."""
    simulator = Simulator(HAIRPIN, performance("table"))
    lateral = LateralScenarios(simulator, aircraft=1)
    drawn = jax.vmap(lateral.draw, out_axes=-1)(jax.random.split(jax.random.key(0), 200)).traffic
    tracker = Tracker(HAIRPIN)
    memory = tracker.begin(drawn, drawn.level_ticks)
    assert np.all(memory.progress.next_fix == 1)
    flown = simulator.advance(drawn)
    assert np.all(tracker.track(memory, flown).progress.next_fix == 1)


def test_a_hairpin_is_passed_at_its_fixes_or_by_turning_early():
    along = [(0.0, lon) for lon in np.arange(-1.35, 0.3, 0.02)]
    assert set(next_fixes(HAIRPIN, along)) == {1, 2}
    assert next_fixes(HAIRPIN, along)[-2:] == [1, 2]  # a mile before S1
    back = [(0.012, lon) for lon in np.arange(0.25, -0.2, -0.02)]
    assert next_fixes(HAIRPIN, [*along[:-3], *back])[-1] == 2  # turned early, never near S1
    onwards = [(0.04, lon) for lon in np.arange(-0.32, 1.0, 0.02)]
    assert next_fixes(HAIRPIN, [*along, *back, (0.02, -0.3), *onwards])[-1] == 4


@pytest.mark.slow
def test_a_crowd_begins_with_its_next_fixes_ahead():
    crowd = Crowd(Simulator(FAR_NORTH, performance("table")), 50)
    traffic = crowd.draw(jax.random.key(0)).traffic
    memory = Tracker(FAR_NORTH).begin(traffic, traffic.level_ticks)
    fixes = FAR_NORTH.route_table.fixes_nm[
        np.asarray(traffic.route), np.asarray(memory.progress.next_fix)
    ]
    ahead = fixes - np.asarray(traffic.position_nm)
    radians = np.radians(np.asarray(traffic.heading_deg))
    assert np.all(np.sum(ahead * np.stack([np.sin(radians), np.cos(radians)], 1), axis=1) > 0.0)


@pytest.mark.parametrize("aside_nm", [-12.0, -0.5, 0.5, 12.0])
def test_the_centreline_of_a_leg_is_its_geodesic(aside_nm):
    """North of 65 N a leg of 300 NM bends by 6 NM from the straight line in the plane."""
    (lat1, lon1), (lat2, lon2) = FAR_NORTH.fixes["WESTE"], FAR_NORTH.fixes["EASTE"]
    on_leg = np.array(WGS84.npts(lon1, lat1, lon2, lat2, 19))
    track, _, _ = WGS84.inv(on_leg[:, 0], on_leg[:, 1], np.full(19, lon2), np.full(19, lat2))
    metres = np.full(19, abs(aside_nm) * METRES_PER_NM)
    lon, lat, _ = WGS84.fwd(*on_leg.T, track + np.sign(aside_nm) * 90.0, metres)
    traffic = traffic_at(FAR_NORTH, np.stack([lat, lon], axis=1))
    memory = Tracker(FAR_NORTH).begin(traffic, traffic.level_ticks)
    found = centreline_distance(FAR_NORTH, traffic, memory)
    assert np.asarray(found) == pytest.approx(aside_nm, abs=0.1)


def test_distances_are_geodesic_far_north():
    points = np.array([(61.5, 10.0), (65.0, 14.0), (67.5, 20.0), (63.0, 18.0)])
    traffic = traffic_at(FAR_NORTH, points)
    memory = Tracker(FAR_NORTH).begin(traffic, traffic.level_ticks + ticks(10.0))
    lat, lon = np.repeat([FAR_NORTH.fixes["WESTE"]], 4, axis=0).T
    fix_nm = WGS84.inv(points[:, 1], points[:, 0], lon, lat)[2] / METRES_PER_NM
    found = np.asarray(next_fix_distance(FAR_NORTH, traffic, memory))
    assert found == pytest.approx(fix_nm, rel=2e-3)
    leg_nm = WGS84.inv(9.0, 65.8, 21.0, 65.8)[2] / METRES_PER_NM
    in_hand = np.asarray(distance_in_hand(FAR_NORTH, traffic, memory))
    assert in_hand == pytest.approx(fix_nm + leg_nm - 466.0 / 120.0, rel=2e-3)


@pytest.mark.slow
def test_exits_over_an_edge_that_bends_in_the_plane():
    """The southern edge is straight in degrees and bends by 4 NM in the plane."""
    sector = replace(
        FAR_NORTH, fixes=dict(FAR_NORTH.fixes) | {"SOUTH": (61.0, 15.0), "SOUTO": (60.0, 15.0)}
    )
    tracker = Tracker(sector)
    for lon in (10.0, 12.5, 15.0, 17.5, 20.0):
        edge_lat = 60.0 + (lon - 9.0) / 12.0 * 2.0
        for step in (0.013, 0.004, 0.001):  # degrees on either side of the edge
            inside, outside = ((edge_lat + sign * step, lon) for sign in (1.0, -1.0))
            before, after = (traffic_at(sector, [point], 1, 180.0) for point in (inside, outside))
            memory = tracker.track(tracker.begin(before, before.level_ticks), before)
            assert bool(memory.progress.entered[0])
            memory = tracker.track(memory, after)
            assert bool(memory.progress.exited[0])
            assert not bool(memory.progress.excursion[0])


def scene(levels_fl, apart_nm, active=True):
    """Aircraft side by side in the middle of a square of 144 NM."""
    count = len(levels_fl)
    traffic = start(
        jnp.asarray([(number * apart_nm, 0.0) for number in range(count)]),
        jnp.zeros(count),
        jnp.asarray([ticks(float(fl)) for fl in levels_fl], dtype=jnp.float32),
        jnp.zeros(count, dtype=jnp.int32),
        jnp.full(count, 466.0),
        jnp.zeros(count, dtype=bool),
    )
    return traffic._replace(active=jnp.asarray(np.broadcast_to(active, count)))


def tracked(*scenes, **changes):
    """The memories after each scene but the first, at which the scenario begins."""
    tracker, memories = Tracker(HAIRPIN), []
    memory = with_fields(tracker.begin(scenes[0], scenes[0].level_ticks), **changes)
    for traffic in scenes[1:]:
        memory = tracker.track(memory, traffic)
        memories.append(memory)
    return memories


def test_losses_use_the_levels_at_the_start_of_a_cycle():
    """They climb apart in the first cycle. In the second they are 2,000 ft apart throughout."""
    first, second = tracked(scene([300, 305], 2.0), scene([300, 320], 2.0), scene([300, 320], 2.0))
    assert float(first.separation.last_nm) == pytest.approx(2.0, abs=1e-3)
    assert float(second.separation.last_nm) == np.inf
    assert float(second.separation.least_nm) == pytest.approx(2.0, abs=1e-3)
    assert second.progress.previous_level_ticks.tolist() == [ticks(300.0), ticks(320.0)]
    assert second.plan.entry_level_ticks.tolist() == [ticks(300.0), ticks(305.0)]


def test_losses_use_the_positions_at_the_start_of_a_cycle():
    first, second = tracked(scene([300, 300], 3.0), scene([300, 300], 9.0), scene([300, 300], 8.0))
    assert float(first.separation.last_nm) == pytest.approx(3.0, abs=1e-3)
    assert float(second.separation.last_nm) == pytest.approx(8.0, abs=1e-3)
    assert float(second.separation.least_nm) == pytest.approx(3.0, abs=1e-3)


def test_exited_aircraft_do_not_lose_separation():
    both = scene([300, 300], 3.0)
    alone = scene([300, 300], 3.0, active=[True, False])
    (memory,) = tracked(both, alone)
    assert float(memory.separation.last_nm) == np.inf
    assert float(tracked(scene([300], 0.0), scene([300], 0.0))[0].separation.last_nm) == np.inf


@pytest.mark.parametrize(
    ("fl", "inside"), [(199.9, False), (200, True), (300, True), (400, True), (400.1, False)]
)
def test_entered_means_inside_the_levels_and_the_area(fl, inside):
    tracker, within = Tracker(HAIRPIN), scene([fl], 0.0)
    assert tracker.begin(within, within.level_ticks).progress.entered.tolist() == [inside]
    outside = within._replace(position_nm=jnp.asarray([[0.0, 75.0]]))
    begun = tracker.begin(outside, outside.level_ticks)
    assert begun.progress.entered.tolist() == [False]
    assert tracker.track(begun, within).progress.entered.tolist() == [inside]
    exited = within._replace(active=jnp.asarray([False]))
    assert tracker.track(begun, exited).progress.entered.tolist() == [False]


def test_excursions_are_of_active_aircraft_that_entered():
    """The second crosses the western edge, which is not an exit."""
    inside, outside = scene([300, 300], -40.0), scene([300, 300], -75.0)
    assert tracked(inside, outside)[0].progress.excursion.tolist() == [False, True]
    assert tracked(inside, outside, entered=jnp.zeros(2, dtype=bool))[
        0
    ].progress.excursion.tolist() == [
        False,
        False,
    ]
    exited = scene([300, 300], -75.0, active=[True, False])
    assert tracked(inside, exited)[0].progress.excursion.tolist() == [False, False]
    back = tracked(inside, outside, inside)[1]
    assert back.progress.excursion.tolist() == [False, True]  # permanently
    still = tracked(inside, outside, outside)[1]
    assert still.progress.excursion.tolist() == [False, True]


@pytest.mark.parametrize(
    ("north_nm", "airway_nm", "expected"),
    [(9.9, 10.0, False), (10.1, 10.0, True), (-10.1, 10.0, True), (10.1, None, False)],
)
def test_leaving_the_airway_is_an_excursion(north_nm, airway_nm, expected):
    """The first leg of the hairpin leads east, so the aircraft is north or south of it."""
    west = HAIRPIN.fixes_nm["WO"][0]
    at = jnp.asarray([[west + 30.0, north_nm]], dtype=jnp.float32)
    traffic = scene([300], 0.0)._replace(position_nm=at)
    tracker = Tracker(HAIRPIN, airway_nm)
    memory = tracker.begin(traffic, traffic.level_ticks)
    assert tracker.track(memory, traffic).progress.excursion.tolist() == [expected]
    exited = traffic._replace(active=jnp.asarray([False]))
    assert tracker.track(memory, exited).progress.excursion.tolist() == [False]


def instruct(memory, action, *aircraft):
    addressed = jnp.asarray([number in aircraft for number in range(2)])
    return Tracker(HAIRPIN).instruct(memory, addressed, jnp.asarray(action, dtype=jnp.int32))


def test_counts_instructions_bursts_and_waiting_cycles():
    """By hand: the same instruction in consecutive cycles continues a burst."""
    traffic, tracker = scene([300, 300], 20.0), Tracker(HAIRPIN)
    memory = tracker.begin(traffic, traffic.level_ticks)
    assert memory.counts.cycles_since_instruction.tolist() == [10.0, 10.0]
    waited, bursts, new = [], [], []
    for action, aircraft in ((1, [0]), (1, [0]), (3, [1]), (0, []), (3, [1]), (1, [])):
        memory = instruct(memory, action, *aircraft)
        new.append(float(memory.counts.new_bursts))
        memory = tracker.track(memory, traffic)
        waited.append(memory.counts.cycles_since_instruction.tolist())
        bursts.append(float(memory.counts.bursts))
        assert float(memory.counts.new_bursts) == 0.0
        assert not np.any(memory.counts.instructed)
    assert waited == [[0, 10], [0, 10], [1, 0], [2, 1], [3, 0], [4, 1]]
    assert bursts == [1, 1, 2, 2, 3, 3]
    assert new == [1, 0, 1, 0, 1, 0]
    assert memory.counts.instructions.tolist() == [2.0, 2.0]
    assert float(memory.progress.cycles) == 6.0
    assert int(memory.counts.burst_action) == 0


def test_a_stack_of_instructions_in_one_cycle_is_one_burst():
    traffic = scene([300, 300], 20.0)
    memory = Tracker(HAIRPIN).begin(traffic, traffic.level_ticks)
    stacked = instruct(instruct(memory, 2, 0), 2, 0)
    assert (float(stacked.counts.new_bursts), float(stacked.counts.bursts)) == (1.0, 1.0)
    assert stacked.counts.instructed.tolist() == [True, False]
    mixed = instruct(instruct(memory, 2, 0), 4, 1)
    assert (float(mixed.counts.new_bursts), float(mixed.counts.bursts)) == (2.0, 2.0)
    assert mixed.counts.instructed.tolist() == [True, True]
    assert mixed.counts.cycles_since_instruction.tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("fl", "entered", "active", "exits", "correctly"),
    [
        (300, True, True, True, True),
        (310, True, True, True, False),
        (300, False, True, False, False),
        (300, True, False, False, False),
    ],
)
def test_exits_through_the_exit_edge(fl, entered, active, exits, correctly):
    """Over the eastern edge of the square, at EE on the equator; the exit level is FL300."""
    east_nm = HAIRPIN.fixes_nm["EE"][0]
    inside, outside = (
        scene([fl], 0.0)._replace(position_nm=jnp.asarray([[east_nm + by, 3.0]]))
        for by in (-0.5, 0.3)
    )
    tracker = Tracker(HAIRPIN)
    memory = tracker.begin(inside, jnp.asarray([ticks(300.0)], dtype=jnp.float32))
    memory = with_fields(memory, entered=jnp.asarray([entered]))
    memory = tracker.track(memory, outside._replace(active=jnp.asarray([active])))
    assert memory.progress.exited.tolist() == [exits]
    assert memory.progress.exited_correctly.tolist() == [correctly]
    assert memory.progress.excursion.tolist() == [False]
    later = tracker.track(memory, outside._replace(active=jnp.asarray([False])))
    assert later.progress.exited.tolist() == [exits]
    assert later.progress.exited_correctly.tolist() == [correctly]
    again = tracker.track(tracker.track(memory, inside), outside)
    assert again.progress.exited.tolist() == [True]  # now, or already before


def test_a_fix_is_passed_within_a_true_mile():
    """A mile before S1 on the equator, and far north, where the plane is stretched."""
    s1_lon = HAIRPIN.fixes["S1"][1]
    for nm, found in ((1.05, 1), (0.95, 2)):
        assert next_fixes(HAIRPIN, [(0.0, s1_lon - nm / 60.0)]) == [found]
    (lat, lon), north = FAR_NORTH.fixes["WESTE"], FAR_NORTH
    for nm, found in ((1.04, 1), (0.96, 2)):
        to_west = WGS84.fwd(lon, lat, 271.0, nm * METRES_PER_NM)[:2]
        assert next_fixes(north, [to_west[::-1]]) == [found]


def test_a_fix_is_passed_abeam_at_any_distance():
    """HERON, CRANE and EGL lie in line to the north-east: the perpendicular at CRANE decides."""
    sector, half = x_plus(), np.sqrt(0.5)
    route = sector.routes.index(("HERON", "CRANE", "EGL", "MACAW", "QUAIL", "SWIFT"))
    for aside_nm in (-15.0, 15.0):
        for along_nm, found in ((-0.3, 1), (0.3, 2)):
            at = sector.fixes_nm["CRANE"] + half * np.array(
                [along_nm + aside_nm, along_nm - aside_nm]
            )
            traffic = traffic_at(sector, [sector.plane.to_degrees(at)], route)
            tracker = Tracker(sector)
            memory = tracker.track(tracker.begin(traffic, traffic.level_ticks), traffic)
            assert int(memory.progress.next_fix[0]) == found


def test_progress_stays_at_the_last_fix_and_never_goes_back():
    fixes = [HAIRPIN.fixes[name] for name in ("S1", "S2", "S3", "EE", "EO")]
    assert next_fixes(HAIRPIN, fixes) == [2, 3, 4, 5, 5]
    assert next_fixes(HAIRPIN, [*fixes, HAIRPIN.fixes["WO"]])[-1] == 5


@pytest.mark.slow
@pytest.mark.parametrize("fixes", [17, 120])
def test_loops_over_long_routes_agree_with_unrolled_code(fixes, monkeypatch):
    """The next fix of a long route is found in a loop, that of a short one by unrolled code."""
    random = np.random.default_rng(fixes)
    lat, lon = 0.4 * random.standard_normal(fixes), np.linspace(-1.1, 1.1, fixes)
    lat[-2] = 0.0
    inner = {f"F{n}": (float(lat[n]), float(lon[n])) for n in range(fixes)}
    named = {"WO": (0.0, -1.35), **inner, "EE": (0.0, 1.2), "EO": (0.0, 1.35)}
    long = Sector("long", (0.0, 0.0), SQUARE, (200, 400), named, (tuple(named), ("WO", "EE", "EO")))
    assert long.route_table.sharp.any()
    count = 400
    traffic = traffic_at(long, random.uniform(-1.3, 1.3, (count, 2)))
    traffic = traffic._replace(route=jnp.arange(count) % 2)
    begun = jnp.asarray(random.integers(1, fixes + 2, count), dtype=jnp.int32)
    begun = jnp.where(traffic.route == 0, begun, 1)
    found = []
    for unrolled in (16, 1000):
        monkeypatch.setattr(progress_module, "MAX_UNROLLED", unrolled)
        found.append(np.asarray(ProgressTracker(long)._next_fix(traffic, begun)))
    np.testing.assert_array_equal(found[0], found[1])
    assert len(np.unique(found[0])) > 5
