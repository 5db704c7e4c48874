"""The learned controller of a sector: stacking in frozen time, one flight after another."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.agents.learned import Learned
from skystack.agents.policy_queries import Queries, _Visited
from skystack.agents.safety_net import ALERT_S
from skystack.agents.transmission import clearance_of
from skystack.simulator.traffic import DIRECT, NO_TURN, ticks
from skystack.stacking import NO_OP
from skystack.tasks.outlook import CLEARED
from skystack.tasks.prediction import HORIZON_S
from skystack.tasks.sector_control import ACTIONS, CLIMB, DESCEND, LEFT_10, RIGHT_10, TO_FIX
from skystack.tasks.sector_observation import NAMES, SINCE_CYCLES
from tests.tasks.sector_traffic import BEGIN, LOOK_AHEAD, SLOTS, TASK, TELL, after

SCRIPTS = {}
"""Scripted policies by name: functions from observed rows to logits."""


def script(function):
    SCRIPTS[function.__name__] = function
    return function


def one_of(chosen, wanted=10.0, others=0.0):
    """The logits of a chosen action for each flight."""
    return jnp.where(jnp.arange(len(ACTIONS))[:, None] == chosen[None], wanted, others)


def to_level(rows, wants_direct):
    above = (rows["fl_sx"] - 0.5) * 400.0
    direct = (rows["own_navigation"] < 0.5) & (rows["direct"] < 0.5) & wants_direct
    chosen = jnp.where(direct, TO_FIX, NO_OP)
    return one_of(jnp.where(above > 5.0, DESCEND, jnp.where(above < -5.0, CLIMB, chosen)))


@script
def to_exit_level(rows):
    """Climbs or descends by tens to the exit level, then goes direct if that is possible."""
    return to_level(rows, True)


@script
def only_to_exit_level(rows):
    return to_level(rows, False)


@script
def turns_for_ever(rows):
    return one_of(jnp.full_like(rows["burst"], LEFT_10, dtype=jnp.int32))


@script
def seesaw(rows):
    """Climbs up to the exit level and descends from above it, without end.

    Above the exit level, it would rather wait.
    """
    above = (rows["fl_sx"] - 0.5) * 400.0 > 5.0
    logits = one_of(jnp.where(above, DESCEND, CLIMB), 1.0, -9.0)
    return logits.at[NO_OP].set(jnp.where(above, 0.9, 0.1))


@script
def waits(rows):
    """Never gives an instruction."""
    return one_of(jnp.full_like(rows["burst"], NO_OP, dtype=jnp.int32), 20.0)


@script
def turns_right(rows):
    """Turns every flight right by 10 degrees."""
    return one_of(jnp.where(rows["burst"] > 0.5, NO_OP, RIGHT_10), 20.0)


def scripted_logits(number, observation):
    """The number of one of `SCRIPTS` takes the place of weights, so all share their programs."""
    rows = dict(zip(NAMES, observation, strict=True))
    return jnp.stack([each(rows) for each in SCRIPTS.values()])[number]


def controller(name="to_exit_level", per_cycle=1, safety_net=True):
    return Learned(Queries(TASK, scripted_logits), number_of(name), per_cycle, safety_net)


def number_of(script):
    return jnp.int32(list(SCRIPTS).index(script))


@pytest.fixture(scope="module")
def world():
    """Flights of which none has been told anything."""
    return jax.device_get(after(60, action=NO_OP).world)


def hearing(world):
    return np.flatnonzero(world.traffic.active & (world.arrivals.held == 0))


@pytest.mark.slow
def test_a_burst_becomes_one_transmission_with_a_fix_and_the_level(world):
    agent = controller()
    agent.begin(world)
    (sent,) = agent.transmit(world)
    assert sent.slot in hearing(world)
    assert sent.heading_deg is None
    assert sent.fix == int(world.progress.next_fix[sent.slot])
    exit_level = float(world.plan.exit_level_ticks[sent.slot])
    cleared = float(world.traffic.cleared_level_ticks[sent.slot])
    assert sent.level_ticks == (None if exit_level == cleared else exit_level)


@pytest.mark.slow
def test_the_state_is_untouched_and_flies_what_was_said(world):
    before = jax.tree.map(np.copy, world)
    agent = controller()
    agent.begin(world)
    sent = agent.transmit(world)
    for one, two in zip(jax.tree.leaves(before), jax.tree.leaves(world), strict=True):
        np.testing.assert_array_equal(one, two)
    told = TELL(world, clearance_of(sent, SLOTS))
    assert int(told.traffic.pending_turn[sent[0].slot]) == DIRECT
    np.testing.assert_array_equal(told.traffic.position_nm, world.traffic.position_nm)


@pytest.mark.slow
def test_every_flight_is_served_at_most_once_in_a_cycle(world):
    agent = controller(per_cycle=100, safety_net=False)
    agent.begin(world)
    slots = [each.slot for each in agent.transmit(world)]
    assert sorted(slots) == hearing(world).tolist()
    limited = controller(per_cycle=2, safety_net=False)
    limited.begin(world)
    first = [each.slot for each in limited.transmit(world)]
    assert first == slots[:2]


@pytest.mark.slow
def test_the_most_urgent_flight_is_served_first(world):
    agent = controller(per_cycle=100)
    agent.begin(world)
    times = BEGIN(world).outlook.time_s[0]
    first = agent.transmit(world)[0].slot
    assert float(times[first]) == float(np.asarray(times)[hearing(world)].min())


@pytest.mark.slow
def test_a_burst_that_turns_in_a_circle_ends_where_it_began_to_repeat(world):
    agent = controller("turns_for_ever")
    agent.begin(world)
    (sent,) = agent.transmit(world)
    heading = float(world.traffic.cleared_heading_deg[sent.slot])
    assert sent.heading_deg == (round(heading) - 10) % 360
    assert sent.instructions == 37  # the first instruction ends own navigation


def test_a_burst_that_repeats_keeps_the_clearance_after_which_the_policy_would_wait(world):
    """A single flight, so all clearances are equally safe."""
    world = alone(world, hearing(world)[0])
    agent = controller("seesaw")
    agent.begin(world)
    highest = ticks(float(TASK.sector.levels_fl[1]))
    (sent,) = agent.transmit(world)
    exit_level = float(world.plan.exit_level_ticks[sent.slot])
    assert exit_level < highest
    assert sent.level_ticks == exit_level + ticks(10.0)


def test_a_burst_that_repeats_keeps_the_clearance_that_loses_separation_last():
    """Even if the policy would rather wait after another one."""
    visited = _Visited.begin(jnp.full(5, 1, dtype=jnp.float32), jnp.float32(0.9), 5)
    assert int(visited.kept) == -1
    for count, (clearance, margin_s) in enumerate([(2, 60.4), (3, 30.5), (2, 60.4)], start=1):
        told = jnp.full(5, clearance, dtype=jnp.float32)
        visited = visited.add(jnp.int32(count), told, jnp.float32(margin_s))
        assert int(visited.kept) == (1 if count == 3 else -1)
    assert bool(visited.is_kept(jnp.full(5, 2, dtype=jnp.float32)))
    assert not bool(visited.is_kept(jnp.full(5, 3, dtype=jnp.float32)))


@pytest.mark.slow
def test_a_long_burst_is_cut_off(world):
    queries = Queries(TASK, scripted_logits, most_instructions=5)
    agent = Learned(queries, number_of("turns_for_ever"), per_cycle=1)
    agent.begin(world)
    (sent,) = agent.transmit(world)
    heading = float(world.traffic.cleared_heading_deg[sent.slot])
    assert (sent.heading_deg, sent.instructions) == ((round(heading) - 50) % 360, 5)


@pytest.mark.slow
def test_the_safety_net_acts_where_the_policy_waits(world):
    """Two flights head on at one level, 25 miles apart."""

    one, other = hearing(world)[:2].tolist()
    meeting = head_on(world, one, other)
    silent = controller("waits", safety_net=False)
    silent.begin(meeting)
    assert silent.transmit(meeting) == []
    agent = controller("waits", per_cycle=5)
    agent.begin(meeting)
    sent = [each for each in agent.transmit(meeting) if each.slot in (one, other)]
    assert len(sent) == 1  # then the other is out of danger, too
    told = TELL(meeting, clearance_of(sent, SLOTS))
    outlook = jax.device_get(LOOK_AHEAD(told))
    assert float(outlook.time_s[0, one]) >= ALERT_S
    assert float(outlook.time_s[0, other]) >= ALERT_S


@pytest.mark.slow
def test_the_safety_net_turns_a_flight_that_would_leave_elsewhere(world):
    """A flight in the north-western arm, 5.5 NM from its edge and heading for it."""
    slot = hearing(world)[0]
    leaving = in_arm(world, slot, 5.5, 45.0)
    agent = controller("waits", per_cycle=5)
    agent.begin(leaving)
    (sent,) = agent.transmit(leaving)
    assert sent.fix is not None or sent.heading_deg is not None
    told = TELL(leaving, clearance_of([sent], SLOTS))
    outlook = jax.device_get(LOOK_AHEAD(told))
    assert float(outlook.leaves_s[CLEARED, slot]) == HORIZON_S
    agent.safety_net = False
    assert agent.transmit(leaving) == []


@pytest.mark.parametrize(("from_edge_nm", "turns"), [(1.0, False), (8.0, True)])
def test_instructions_that_cause_an_alert_are_not_given(world, from_edge_nm, turns):
    """The flight is parallel to the edge, and the policy turns it towards the edge."""
    slot = hearing(world)[0]
    parallel = in_arm(world, slot, from_edge_nm, 315.0)
    agent = controller("turns_right")
    agent.begin(parallel)
    sent = agent.transmit(parallel)
    assert [each.heading_deg for each in sent] == ([325] if turns else [])


def in_arm(world, slot, from_edge_nm, heading_deg):
    """A world of one flight in the arm of X-Plus that points north-west, 25 NM from its middle."""
    across = (14.0 - from_edge_nm * np.sqrt(2.0)) / 2.0  # the edge is where east + north = 14 NM
    position = (across - 18.0, across + 18.0)
    return alone(placed(world, slot, position, heading_deg, entered=True), slot)


def placed(world, slots, position_nm, heading_deg, entered):
    """The world with flights at other positions, which hold their headings."""
    traffic, progress = world.traffic, world.progress
    position, heading, own, pending, inside = map(
        np.array,
        (
            traffic.position_nm,
            traffic.heading_deg,
            traffic.own_navigation,
            traffic.pending_turn,
            progress.entered,
        ),
    )
    position[slots], heading[slots], inside[slots] = position_nm, heading_deg, entered
    own[slots], pending[slots] = False, NO_TURN
    traffic = traffic._replace(
        position_nm=position,
        heading_deg=heading,
        flown_heading_deg=heading,
        cleared_heading_deg=heading,
        own_navigation=own,
        pending_turn=pending,
        turn_deg=np.zeros_like(heading),
    )
    return world._replace(traffic=traffic, progress=progress._replace(entered=inside))


def alone(world, slot):
    active = np.zeros_like(world.traffic.active)
    active[slot] = True
    return world._replace(traffic=world.traffic._replace(active=active))


def head_on(world, one, other):
    """The world with two flights on opposite headings, 25 NM apart, far outside the others."""
    pair, positions = [one, other], [(60.0, -75.0), (60.0, -50.0)]
    world = placed(world, pair, positions, (0.0, 180.0), entered=False)
    level = np.array(world.traffic.level_ticks)
    level[pair] = ticks(300.0)
    levels = dict.fromkeys(("level_ticks", "flown_level_ticks", "cleared_level_ticks"), level)
    return world._replace(traffic=world.traffic._replace(**levels))


def test_observes_the_time_since_a_transmission(world):
    """In the next cycle, that of the flight is one, and no other has had a transmission."""
    agent = controller()
    agent.begin(world)
    (sent,) = agent.transmit(world)
    query = agent._begin(agent._weights, world, agent._since.cycles(world))
    assert float(query.state.since_cycles[sent.slot]) == 1.0
    others = np.delete(np.asarray(query.state.since_cycles), sent.slot)
    assert np.all(others == SINCE_CYCLES)


def test_nothing_is_said_if_nothing_changes(world):
    at_exit_level = world.plan.exit_level_ticks
    level = world._replace(
        traffic=world.traffic._replace(cleared_level_ticks=at_exit_level, level_ticks=at_exit_level)
    )
    agent = controller("only_to_exit_level")
    agent.begin(level)
    assert agent.transmit(level) == []
