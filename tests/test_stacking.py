"""Online action-stacking: its rule, in Python and inside jit, and what a stack leaves unchanged."""

import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.errors import InputError
from skystack.evaluation.rollout import Controller, fly, network_controller
from skystack.learning.seeds import scenario_key
from skystack.policies.shipped import find_policy
from skystack.stacking import (
    ENDLESS,
    TwoPhase,
    checked_limit,
    stack,
    stack_many,
    stack_many_traced,
    stack_traced,
)
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

LEFT_1, RIGHT_1, LEFT_2, RIGHT_2 = 1, 2, 3, 4


class Counter:
    """A minimal two-phase environment: it collects its instructions, seven per stack at most."""

    def observe(self, state):
        return state

    def instruct(self, state, action):
        return (*state, action)

    def may_stack(self, state, action):
        return len(state) < 7


def script(*answers):
    """A policy that returns these actions in turn, whatever it observes."""
    given = iter(answers)
    return lambda observation: next(given)


@pytest.mark.parametrize(
    ("answers", "issued"),
    [
        ((0,), ()),
        ((1, 0), (1,)),
        ((1, 1, 1, 0), (1, 1, 1)),
        ((1, 1, 2), (1, 1)),
        ((2, 2, 2, 1), (2, 2, 2)),
        ((3, 3, 1, 3), (3, 3)),
        ((1,) * 9, (1,) * 7),
    ],
    ids=["none", "one", "three", "reverse", "reverse back", "other aircraft", "limit"],
)
def test_stack_is_the_run_of_the_first_action(answers, issued):
    state, result = stack(Counter(), script(*answers), ())
    assert state == issued
    assert result.instructions == len(issued)
    assert result.action == answers[0]


def test_actions_need_not_be_integers():
    state, result = stack(Counter(), script("left", "left", "right"), ())
    assert state == ("left", "left")
    assert result == ("left", 2)


def expected_counts(answers, most):
    """The expected numbers of instructions and of queries; at most `most` instructions are allowed.

    The instructions are the run of the first answer, cut at `most`. A run that is not cut takes one
    more query, whose answer ends it.
    """
    run = len(list(next(itertools.groupby(answers))[1])) if answers[0] else 0
    return (run, run + 1) if run < most else (most, max(most, 1))


def recorded(answers):
    """A policy that returns these actions in turn, and the list of its observations."""
    seen = []

    def policy(observation):
        seen.append(observation)
        return answers[len(seen) - 1]

    return policy, seen


@given(st.lists(st.integers(0, 3), min_size=9, max_size=9), st.integers(1, 9), st.integers(0, 7))
def test_stack_is_the_longest_prefix_of_equal_actions(answers, limit, allowed):
    """The policy is not queried if its answer cannot be used."""
    environment = Counter()
    environment.may_stack = lambda state, action: len(state) < allowed
    policy, seen = recorded(answers)
    state, result = stack(environment, policy, (), limit=limit)
    instructions, queries = expected_counts(answers, min(limit, allowed))
    assert state == (answers[0],) * instructions
    assert result.instructions == instructions
    assert seen == [(answers[0],) * query for query in range(queries)]


def test_limit_of_one_disables_stacking():
    """A stateful policy that instructs at every third call instructs in every third cycle."""
    policy, seen = recorded([1, 0, 0] * 4)
    issued = [stack(Counter(), policy, (), limit=1)[1].instructions for _ in range(12)]
    assert issued == [1, 0, 0] * 4
    assert len(seen) == 12


def test_queries_as_often_inside_jit():
    """The policy calls back into Python, where each query consumes one of the given answers."""

    class Numbers(Counter):
        def instruct(self, state, action):
            return state + 1

        def may_stack(self, state, action):
            return state < 3

    whole = jax.ShapeDtypeStruct((), jnp.int32)
    given = []

    def policy(observation, key):
        return jax.experimental.io_callback(lambda: np.int32(given.pop(0)), whole)

    zero, key = jnp.zeros((), dtype=jnp.int32), jax.random.key(0)
    for limit in (1, 2, 9):
        compiled = jax.jit(lambda limit=limit: stack_traced(Numbers(), policy, zero, key, limit))
        for answers in itertools.product(range(3), repeat=4):
            given[:] = answers
            state, result = compiled()
            found = int(result.instructions), len(answers) - len(given)
            assert found == expected_counts(answers, min(limit, 3)), answers
            assert int(state) == found[0]


@pytest.mark.parametrize("shape", [(), (1,)])
def test_policy_may_reuse_one_array_for_all_actions(shape):
    """Every sequence of four actions; the array is overwritten between the calls."""
    buffer = np.zeros(shape, dtype=np.int64)

    class Overwriting(Counter):
        def observe(self, state):
            buffer[...] = 3
            return state

        def instruct(self, state, action):
            buffer[...] = 3
            return (*state, int(action.item()))

    def policy(answers, observation):
        buffer[...] = answers[len(observation)]
        return buffer

    for answers in itertools.product(range(4), repeat=4):
        for limit in (1, 3):
            state, result = stack(Overwriting(), lambda seen, a=answers: policy(a, seen), (), limit)
            buffer[...] = 3
            instructions, _ = expected_counts(answers, limit)
            assert state == (answers[0],) * instructions
            assert result.instructions == instructions
            assert result.action == answers[0]


def test_compares_actions_without_equality_by_identity():
    """Objects that do not define equality are equal only to themselves."""
    left = object()
    assert stack(Counter(), script(left, left, 0), ()) == ((left, left), (left, 2))


@pytest.mark.parametrize("limit", [0, -1, True, False])
def test_rejects_a_limit_below_one_before_any_query(limit):
    policy, seen = recorded([1] * 9)
    zeros, key = np.zeros(2, dtype=int), jax.random.key(0)
    for attempt in (
        lambda: stack(Counter(), policy, (), limit),
        lambda: stack_traced(Counter(), lambda observation, key: policy(0), 0, key, limit),
        lambda: stack_many(Counters(), lambda *seen: policy(0), zeros, zeros == 0, limit),
        lambda: stack_many_traced(Counters(), lambda *seen: policy(0), zeros, zeros == 0, limit),
    ):
        with pytest.raises(InputError, match=r"^limit is .* \(allowed: whole numbers from 1\)$"):
            attempt()
    assert seen == []


@pytest.mark.parametrize(
    "limit", [2.5, float("nan"), "3", None, [1], np.array([1, 2]), np.int64(0)]
)
def test_limit_must_be_a_whole_number(limit):
    with pytest.raises(InputError, match="limit is "):
        checked_limit(limit)
    assert [checked_limit(number) for number in (1, np.int8(7), np.array(3))] == [1, 7, 3]


class Counters:
    """Counters of many scenarios at once: instructions per scenario, seven at most."""

    def observe(self, state):
        return state

    def instruct(self, state, action):
        return state + 1

    def may_stack(self, state, action):
        return state < 7

    def choose(self, condition, yes, no):
        return jax.tree.map(lambda a, b: np.where(condition, a, b), yes, no)


class TracedCounters(Counters):
    def choose(self, condition, yes, no):
        return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


@jax.jit
def traced_stacks(table, asking, limit):
    scenarios = jnp.arange(len(table))

    def policy(observation, mask, query):
        return table[scenarios, query]

    return stack_many_traced(TracedCounters(), policy, jnp.zeros_like(scenarios), asking, limit)


@given(
    st.lists(st.lists(st.integers(0, 2), min_size=9, max_size=9), min_size=1, max_size=5),
    st.integers(1, 9),
    st.data(),
)
def test_stack_many_equals_stacking_each_scenario(answers, limit, data):
    """Each scenario is queried as often as alone, and never if it is not in the mask."""
    count = len(answers)
    asking = np.array(data.draw(st.lists(st.booleans(), min_size=count, max_size=count)))
    table, queried = np.array(answers), np.zeros(count, dtype=int)

    buffer = np.zeros(count, dtype=int)

    def policy(observation, mask, query):
        assert mask.any() or not asking.any()
        queried[mask] += 1
        buffer[:] = np.where(mask, table[np.arange(count), query], 0)
        return buffer

    state, issued = stack_many(Counters(), policy, np.zeros(count, dtype=int), asking, limit)
    traced_state, traced = traced_stacks(jnp.asarray(table, dtype=jnp.int32), asking, limit)
    assert traced_state.tolist() == state.tolist()
    assert traced.instructions.tolist() == issued.instructions.tolist()
    assert traced.action.tolist() == np.where(asking, issued.action, 0).tolist()
    for number, actions in enumerate(answers):
        if not asking[number]:
            assert (state[number], issued.instructions[number], queried[number]) == (0, 0, 0)
            assert issued.action[number] == 0
            continue
        instructions, queries = expected_counts(actions, min(limit, 7))
        assert state[number] == issued.instructions[number] == instructions
        assert issued.action[number] == actions[0]
        assert queried[number] == queries


def test_every_query_inside_jit_draws_a_new_sample():
    """A fair coin instructs k times with probability 1 / 2 ** (k + 1), but at most 7 times."""

    class Numbers(Counter):
        def instruct(self, state, action):
            return state + action

        def may_stack(self, state, action):
            return state < 7

    def coin(observation, key):
        return jax.random.bernoulli(key).astype(jnp.int32)

    def burst(key):
        return stack_traced(Numbers(), coin, jnp.zeros((), dtype=jnp.int32), key)[1].instructions

    drawn = 4000
    bursts = np.asarray(jax.jit(jax.vmap(burst))(jax.random.split(jax.random.key(1), drawn)))
    for k, share in [(k, 0.5 ** (k + 1)) for k in range(7)] + [(7, 0.5**7)]:
        spread = np.sqrt(share * (1 - share) / drawn)
        assert abs(np.mean(bursts == k) - share) < 5 * spread, k


class Endless(Counter):
    """Its stacks never end; only actions 0, 1 and 2 are valid."""

    def may_stack(self, state, action):
        return True

    def checked_action(self, action):
        if action not in (0, 1, 2):
            raise InputError(f"action is {action}")
        return action


def test_endless_stack_is_an_error():
    with pytest.raises(InputError, match=r"endless stack: .* action 2 1000 times in one cycle"):
        stack(Endless(), lambda observation: 2, ())
    assert stack(Endless(), lambda observation: 2, (), limit=1500)[1].instructions == 1500


def test_endless_compiled_stack_ends():
    class Numbers(Endless):
        def instruct(self, state, action):
            return state + action

    def policy(observation, key):
        return jnp.ones((), dtype=jnp.int32)

    start = jnp.zeros((), dtype=jnp.int32)
    state, result = stack_traced(Numbers(), policy, start, jax.random.key(0))
    assert (int(state), int(result.instructions)) == (ENDLESS, ENDLESS)


@pytest.mark.parametrize("answers", [(7,), (1, 1, 7), (2, float("nan"))])
def test_names_an_invalid_action_at_any_query(answers):
    with pytest.raises(InputError, match=f"action is {answers[-1]}"):
        stack(Endless(), script(*answers), ())


def test_every_query_observes_the_previous_instructions():
    seen = []

    def policy(observation):
        seen.append(observation)
        return 1 if len(observation) < 3 else 0

    stack(Counter(), policy, ())
    assert seen == [(), (1,), (1, 1), (1, 1, 1)]


def test_lateral_task_is_a_two_phase_environment(lateral):
    assert isinstance(lateral, TwoPhase)


@pytest.fixture(scope="module")
def lateral():
    return build_task(NavigationSettings())


def lookup(observation):
    """A table policy: steer the aircraft that points more than 5 degrees off its next fix."""
    off_1, off_2 = observation[0] - 0.5, observation[4] - 0.5
    threshold = 5.0 / 360.0
    return (
        LEFT_1 * (off_1 < -threshold)
        + RIGHT_1 * (off_1 > threshold)
        + LEFT_2 * ((abs(off_1) <= threshold) & (off_2 < -threshold))
        + RIGHT_2 * ((abs(off_1) <= threshold) & (off_2 > threshold))
    )


def states_after(task, count, cycles):
    """The states of `count` scenarios after some cycles without instructions."""

    def one(key):
        return jax.lax.fori_loop(0, cycles, lambda _, s: task.advance(s)[0], task.reset(key))

    return jax.vmap(one)(jnp.stack([scenario_key(0, number) for number in range(count)]))


def traced_lookup(observation, key):
    threshold = 5.0 / 360.0
    off_1, off_2 = observation[0] - 0.5, observation[4] - 0.5
    first = jnp.where(off_1 < -threshold, LEFT_1, jnp.where(off_1 > threshold, RIGHT_1, 0))
    second = jnp.where(off_2 < -threshold, LEFT_2, jnp.where(off_2 > threshold, RIGHT_2, 0))
    return jnp.where(first != 0, first, second).astype(jnp.int32)


def row(states, index):
    return jax.tree.map(lambda values: values[index], states)


PHYSICAL = ("position_nm", "heading_deg", "level_ticks", "ground_speed_kt", "vertical_speed_ft_min")


@pytest.mark.slow
def test_stack_changes_no_physical_state(lateral):
    """Bit for bit: positions, headings, speeds, levels, time, and the clearances being flown."""
    before = states_after(lateral, 500, 60)
    after, stacks = jax.jit(
        jax.vmap(lambda s: stack_traced(lateral, traced_lookup, s, jax.random.key(0)))
    )(before)
    assert int(jnp.max(stacks.instructions)) >= 3
    for name in (
        *PHYSICAL,
        "flown_heading_deg",
        "turn_deg",
        "flown_level_ticks",
        "next_fix",
        "active",
    ):
        old, new = getattr(before.traffic, name), getattr(after.traffic, name)
        assert np.asarray(old).tobytes() == np.asarray(new).tobytes(), name
    for name in ("cycles", "previous_nm", "next_fix", "entered", "exited", "excursion"):
        old, new = (getattr(each.memory.progress, name) for each in (before, after))
        assert np.asarray(old).tobytes() == np.asarray(new).tobytes(), name


def test_lateral_task_limits_a_stack_to_half_a_turn(lateral):
    """A stack that the policy never ends is ended before the turn would reverse."""
    state = lateral.reset(jax.random.key(3))
    instructed, result = stack_traced(
        lateral, lambda o, k: jnp.asarray(RIGHT_2, dtype=jnp.int32), state, jax.random.key(0)
    )
    start, cleared = state.traffic.heading_deg[1], instructed.traffic.cleared_heading_deg[1]
    assert 170.0 <= float(cleared - start) % 360.0 < 180.0
    assert int(result.instructions) in (17, 18)


class Phases(NamedTuple):
    """The lateral task, compiled function by function for a plain Python loop.

    A state consists of the task's state, its observation, and which actions may be stacked.
    """

    reset: Any
    observe: Any
    instruct: Any
    may_stack: Any
    advance: Any


@pytest.fixture(scope="module")
def phases(lateral):
    actions = jnp.arange(len(lateral.action_names), dtype=jnp.int32)

    def extend(state):
        allowed = jax.vmap(lambda action: lateral.may_stack(state, action))(actions)
        return state, lateral.observe(state), allowed

    def advance(state):
        state, outcome = lateral.advance(state)
        return extend(state), outcome.ended

    jitted_instruct = jax.jit(lambda state, action: extend(lateral.instruct(state, action)))
    jitted_advance = jax.jit(advance)
    return Phases(
        reset=jax.jit(lambda key: extend(lateral.reset(key))),
        observe=lambda state: np.asarray(state[1]),
        instruct=lambda state, action: jitted_instruct(state[0], action),
        may_stack=lambda state, action: bool(np.asarray(state[2])[action]),
        advance=lambda state: jitted_advance(state[0]),
    )


def fly_in_python(phases, policy, number):
    """Fly a scenario with `stack` in a Python loop; (cycle, action, count) of each clearance."""
    state, issued = phases.reset(scenario_key(0, number)), []
    for cycle in range(300):
        state, result = stack(phases, policy, state)
        if result.instructions:
            issued.append((cycle, result.action, result.instructions))
        state, ended = phases.advance(state)
        if ended:
            break
    return issued


def clearances(recording, number):
    counts, actions = recording.instructions[number], recording.action[number]
    return [(int(c), int(actions[c]), int(counts[c])) for c in np.nonzero(counts)[0]]


SCENARIOS = 100


@pytest.mark.slow
def test_python_and_jit_stack_alike_with_a_table_policy(lateral, phases):
    recording = fly(
        lateral, Controller(lambda _, seen, key: traced_lookup(seen, key)), 0, SCENARIOS, True
    )
    assert recording.instructions.max() >= 3
    for number in range(SCENARIOS):
        in_python = fly_in_python(phases, lambda seen: int(lookup(seen)), number)
        assert in_python == clearances(recording, number), number


@pytest.mark.slow
def test_python_and_jit_stack_alike_with_the_network(lateral, phases):
    """NumPy and XLA add in different orders, so they may decide near-ties of logits differently."""
    policy = find_policy("lateral")
    controller = network_controller(policy.actor, policy.normaliser, greedy=True)
    recording = fly(lateral, controller, 0, SCENARIOS, True)
    different = 0
    for number in range(SCENARIOS):
        margins = []

        def query(seen, margins=margins):
            logits = np.sort(policy.logits(seen))
            margins.append(float(logits[-1] - logits[-2]))
            return policy(seen)

        in_python, in_jit = fly_in_python(phases, query, number), clearances(recording, number)
        if in_python != in_jit:
            different += 1
            assert min(margins) < 1e-3, f"scenario {number} differs without a near-tie"
    assert different <= 1
