"""The learned controller of a sector: stacking in frozen time, one flight after another."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.agents.learned import MOST_INSTRUCTIONS, Learned
from skystack.agents.transmission import Transmission, clearance_of
from skystack.learning.policy import Policy
from skystack.simulator.traffic import DIRECT
from skystack.stacking import NO_OP
from skystack.tasks.sector_control import ACTIONS, CLIMB, DESCEND, LEFT_10, TO_FIX
from skystack.tasks.sector_observation import NAMES, SINCE_CYCLES
from tests.tasks.sector_traffic import SLOTS, TASK, after

ADVANCE = jax.jit(TASK.world.advance)


class ToExitLevel(Learned):
    """Climbs or descends by tens to the exit level, then goes direct if that is possible."""

    wants_direct = True

    def _logits(self, observation):
        rows = dict(zip(NAMES, observation, strict=True))
        above = (rows["fl_sx"] - 0.5) * 400.0
        direct = (rows["own_navigation"] < 0.5) & (rows["direct"] < 0.5) & self.wants_direct
        chosen = jnp.where(direct, TO_FIX, NO_OP)
        chosen = jnp.where(above > 5.0, DESCEND, jnp.where(above < -5.0, CLIMB, chosen))
        return jnp.where(jnp.arange(len(ACTIONS))[:, None] == chosen[None], 10.0, 0.0)


class Turner(Learned):
    """Turns left for ever."""

    def _logits(self, observation):
        rows = jnp.arange(len(ACTIONS))[:, None] == jnp.full(observation.shape[1], LEFT_10)[None]
        return jnp.where(rows, 10.0, 0.0)


def controller(kind=ToExitLevel, per_cycle=1):
    return kind(object.__new__(Policy), TASK, per_cycle)  # the kinds above need no weights


@pytest.fixture(scope="module")
def world():
    """Flights of which none has been told anything."""
    return jax.device_get(after(60, action=NO_OP).world)


def hearing(world):
    return np.flatnonzero(world.traffic.active & (world.arrivals.held == 0))


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


def test_the_state_is_untouched_and_flies_what_was_said(world):
    before = jax.tree.map(np.copy, world)
    agent = controller()
    agent.begin(world)
    sent = agent.transmit(world)
    for one, two in zip(jax.tree.leaves(before), jax.tree.leaves(world), strict=True):
        np.testing.assert_array_equal(one, two)
    told = TASK.world.instruct(world, clearance_of(sent, SLOTS))
    assert int(told.traffic.pending_turn[sent[0].slot]) == DIRECT
    np.testing.assert_array_equal(told.traffic.position_nm, world.traffic.position_nm)


def test_every_flight_is_served_at_most_once_in_a_cycle(world):
    agent = controller(per_cycle=100)
    agent.begin(world)
    slots = [each.slot for each in agent.transmit(world)]
    assert sorted(slots) == hearing(world).tolist()
    limited = controller(per_cycle=2)
    limited.begin(world)
    first = [each.slot for each in limited.transmit(world)]
    assert first == slots[:2]


def test_the_most_urgent_flight_is_served_first(world):
    agent = controller(per_cycle=100)
    agent.begin(world)
    times = TASK.begin(jax.tree.map(jnp.asarray, world)).outlook.time_s[0]
    first = agent.transmit(world)[0].slot
    assert float(times[first]) == float(np.asarray(times)[hearing(world)].min())


def test_an_endless_burst_is_cut_off(world):
    agent = controller(Turner)
    agent.begin(world)
    (sent,) = agent.transmit(world)
    heading = float(world.traffic.cleared_heading_deg[sent.slot])
    assert sent.heading_deg == (round(heading) - 10 * MOST_INSTRUCTIONS) % 360


def test_the_time_since_a_transmission_belongs_to_the_flight(world):
    agent = controller()
    agent.begin(world)
    (sent,) = agent.transmit(world)
    assert agent._since[sent.slot] == 1.0
    other = world._replace(arrivals=world.arrivals._replace(flight=world.arrivals.flight + 1))
    agent.transmit(other)
    assert agent._since[sent.slot] in {1.0, SINCE_CYCLES}


def test_nothing_is_said_if_nothing_changes(world):
    class Nobody(ToExitLevel):
        wants_direct = False

    at_exit_level = world.plan.exit_level_ticks
    level = world._replace(
        traffic=world.traffic._replace(cleared_level_ticks=at_exit_level, level_ticks=at_exit_level)
    )
    agent = controller(Nobody)
    agent.begin(level)
    assert agent.transmit(level) == []


def test_a_transmission_is_a_tuple_of_slot_heading_fix_and_level():
    assert Transmission(3) == (3, None, None, None)
