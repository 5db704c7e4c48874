"""Action tables: what each action changes, for which aircraft, and what can be stacked."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.simulator.traffic import start, ticks
from skystack.tasks.actions import ActionTable, large_turns, level_changes, small_turns, turns


def traffic_of(headings, cleared, levels_fl=300.0, active=True):
    count = len(headings)
    levels = np.broadcast_to(levels_fl, count)
    traffic = start(
        jnp.zeros((count, 2)),
        jnp.asarray(headings, dtype=jnp.float32),
        jnp.asarray([ticks(float(fl)) for fl in levels], dtype=jnp.float32),
        jnp.zeros(count, dtype=jnp.int32),
        jnp.full(count, 466.0),
        jnp.zeros(count, dtype=bool),
    )
    return traffic._replace(
        cleared_heading_deg=jnp.asarray(cleared, dtype=jnp.float32),
        active=jnp.asarray(np.broadcast_to(active, count)),
    )


def as_array(action):
    return jnp.asarray(action, dtype=jnp.int32)


def changes(table):
    """The aircraft and change of every action except the no-op."""
    return [(action.aircraft, action.change) for action in table.actions[1:]]


def test_order_of_actions():
    """Aircraft by aircraft, minus before plus, small before large."""
    assert changes(small_turns(2)) == [(0, -10), (0, 10), (1, -10), (1, 10)]
    assert small_turns(2).names[3] == "aircraft 2 turn -10 deg"
    nine = range(10, 91, 10)
    both = [*(-size for size in nine), *nine]
    assert changes(large_turns(2)) == [(aircraft, size) for aircraft in (0, 1) for size in both]
    levels = level_changes(2, (100, 300))
    assert changes(levels) == [(0, -10), (0, 10), (1, -10), (1, 10)]
    assert {action.kind for action in small_turns(1).actions[1:]} == {"heading"}
    assert {action.kind for action in levels.actions[1:]} == {"level"}


def test_an_action_addresses_one_aircraft_or_none():
    table = small_turns(3)
    traffic = traffic_of([0.0] * 3, [0.0] * 3)
    for action in range(7):
        expected = [action > 0 and (action - 1) // 2 == aircraft for aircraft in range(3)]
        assert table.addressed(traffic, as_array(action)).tolist() == expected
    many = table.addressed(traffic, jnp.asarray([0, 2, 5], dtype=jnp.int32))
    assert many.tolist() == [[False, True, False], [False, False, False], [False, False, True]]


@pytest.mark.parametrize(
    ("cleared", "action", "expected"),
    [
        (350.0, 2, 0.0),  # to the right through north
        (5.0, 1, 355.0),
        (45.19, 2, 55.0),  # rounded to whole degrees
        (44.6, 1, 35.0),
        (180.0, 0, 180.0),
    ],
)
def test_turns_start_at_the_cleared_heading(cleared, action, expected):
    traffic = traffic_of([90.0, 90.0], [cleared, 77.0])
    instructed = small_turns(2).instruct(traffic, as_array(action))
    assert instructed.cleared_heading_deg.tolist() == [expected, 77.0]
    assert instructed.cleared_level_ticks.tolist() == traffic.cleared_level_ticks.tolist()


@pytest.mark.parametrize(
    ("heading", "cleared", "action", "possible"),
    [
        (0.0, 160.0, 2, True),  # 170 degrees to the right
        (0.0, 170.0, 2, False),  # 180 has no side
        (0.0, 175.0, 2, False),
        (0.0, 185.0, 1, False),
        (0.0, 170.0, 1, True),
        (0.0, 190.0, 1, False),
        (0.0, 190.0, 2, True),
        (100.0, 270.0, 2, False),
        (100.0, 270.0, 3, True),  # for the other aircraft
        (100.0, 270.0, 0, False),
    ],
)
def test_turns_are_stacked_only_below_180_degrees(heading, cleared, action, possible):
    traffic = traffic_of([heading, 0.0], [cleared, 0.0])
    assert bool(small_turns(2).may_stack(traffic, as_array(action))) is possible
    exited = traffic._replace(active=jnp.zeros(2, dtype=bool))
    assert not bool(small_turns(2).may_stack(exited, as_array(action)))


@pytest.mark.parametrize(
    ("cleared_fl", "action", "expected_fl", "possible"),
    [
        (200.0, 1, 190.0, True),
        (200.0, 2, 210.0, True),
        (290.0, 2, 300.0, True),
        (300.0, 2, 300.0, False),
        (295.0, 2, 300.0, False),
        (110.0, 1, 100.0, True),
        (100.0, 1, 100.0, False),
        (105.0, 1, 100.0, False),
        (200.0, 0, 200.0, False),
    ],
)
def test_levels_are_cleared_within_the_sector(cleared_fl, action, expected_fl, possible):
    table = level_changes(2, (100, 300))
    traffic = traffic_of([0.0, 0.0], [0.0, 0.0], [cleared_fl, 150.0])
    assert bool(table.may_stack(traffic, as_array(action))) is possible
    instructed = table.instruct(traffic, as_array(action))
    assert instructed.cleared_level_ticks.tolist() == [ticks(expected_fl), ticks(150.0)]
    assert instructed.cleared_heading_deg.tolist() == [0.0, 0.0]
    exited = traffic._replace(active=jnp.zeros(2, dtype=bool))
    assert not bool(table.may_stack(exited, as_array(action)))


def batched(scenarios):
    """The scenarios as one batch, with the batch axis last."""
    return jax.tree.map(lambda *rows: jnp.stack(rows, axis=-1), *scenarios)


def test_batched_scenarios_are_instructed_independently():
    table = turns(2, (10, 30))
    alone = [traffic_of([0.0, 0.0], [20.0 * case, 300.0]) for case in range(3)]
    instructed = table.instruct(batched(alone), jnp.asarray([1, 4, 6], dtype=jnp.int32))
    assert instructed.cleared_heading_deg.tolist() == [[350.0, 50.0, 40.0], [300.0, 300.0, 270.0]]


@pytest.mark.parametrize("table", [small_turns(2), level_changes(2, (200, 400))])
def test_batched_scenarios_are_stacked_independently(table):
    """In scenario 1 the first aircraft is at its limit, in scenario 2 the second has exited."""
    limits = [
        traffic_of([0.0, 0.0], [170.0, 0.0], [400.0, 300.0]),
        traffic_of([0.0, 0.0], [0.0, 0.0], 300.0, active=[True, False]),
        traffic_of([0.0, 0.0], [0.0, 0.0], 300.0),
    ]
    scenarios = batched(limits)
    for action, expected in enumerate(
        [[False] * 3, [True] * 3, [False, True, True], [True, False, True], [True, False, True]]
    ):
        actions = jnp.full(3, action, dtype=jnp.int32)
        assert table.may_stack(scenarios, actions).tolist() == expected


def test_a_table_can_have_headings_and_levels():
    """Each action changes, and is limited by, only the value of its kind."""
    table = ActionTable((*small_turns(2).actions, *level_changes(2, (200, 400)).actions[1:]))
    table = ActionTable(table.actions, (200, 400))
    assert table.kinds == {"heading", "level"}
    traffic = traffic_of([0.0, 0.0], [170.0, 20.0], [300.0, 400.0])
    allowed = [bool(table.may_stack(traffic, as_array(action))) for action in range(9)]
    assert allowed == [False, True, False, True, True, True, True, True, False]
    turned, climbed = (table.instruct(traffic, as_array(action)) for action in (4, 6))
    assert turned.cleared_heading_deg.tolist() == [170.0, 30.0]
    assert turned.pending_turn.tolist() == [0, 1]
    assert turned.cleared_level_ticks.tolist() == traffic.cleared_level_ticks.tolist()
    assert climbed.cleared_level_ticks.tolist() == [ticks(310.0), ticks(400.0)]
    assert climbed.cleared_heading_deg.tolist() == [170.0, 20.0]
    assert climbed.pending_turn.tolist() == [0, 0]
    together = table.may_stack(batched([traffic] * 9), jnp.arange(9, dtype=jnp.int32))
    assert together.tolist() == allowed
