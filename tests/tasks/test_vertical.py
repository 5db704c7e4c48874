"""The vertical task of the paper: scenarios, observations, actions and rewards."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.errors import InputError
from skystack.learning.experiment import load_experiment
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import start, ticks
from skystack.stacking import stack
from skystack.tasks.conformance import check_task
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

NO_OP, DESCEND, CLIMB = range(3)
STRAIGHT = ("HERON", "CRANE", "EGL", "MACAW", "QUAIL", "SWIFT")


@pytest.fixture(scope="module")
def task():
    return build_task(load_experiment("vertical").task)


def action(number):
    return jnp.asarray(number, dtype=jnp.int32)


def begin(task, entry_fl, exit_fl):
    """A scenario of one aircraft that starts at the first fix of the straight route."""
    sector = task.simulator.sector
    level = jnp.full(1, ticks(entry_fl), dtype=jnp.float32)
    route = sector.routes.index(STRAIGHT)
    traffic = start(
        jnp.asarray(sector.fixes_nm["HERON"][None], dtype=jnp.float32),
        jnp.asarray([sector.first_heading_deg(STRAIGHT)], dtype=jnp.float32),
        level,
        jnp.full(1, route, dtype=jnp.int32),
        task.simulator.level_ground_speed_kt(level),
        jnp.ones(1, dtype=bool),
    )
    return task.begin(traffic, jnp.full(1, ticks(exit_fl), dtype=jnp.float32))


@pytest.mark.slow
def test_satisfies_the_contract(task):
    check_task(task)
    assert task.action_names == ("none", "aircraft 1 level -10 FL", "aircraft 1 level +10 FL")


def test_draws_scenarios_as_in_the_papers_table(task):
    keys = jax.random.split(jax.random.key(5), 4000)
    drawn = jax.tree.map(np.asarray, jax.jit(jax.vmap(task.scenarios.draw))(keys))
    levels = np.arange(100, 301, 10)
    for level in (drawn.traffic.level_ticks, drawn.exit_level_ticks):
        found, counts = np.unique(level / TICKS_PER_FL, return_counts=True)
        assert found.tolist() == levels.tolist()
        # 21 levels, 190 of each on average: five standard deviations.
        assert np.all(np.abs(counts - 4000 / 21) < 5 * np.sqrt(4000 / 21))
    correlation = np.corrcoef(drawn.traffic.level_ticks[:, 0], drawn.exit_level_ticks[:, 0])[0, 1]
    assert abs(correlation) < 5 / np.sqrt(4000)
    sector = task.simulator.sector
    fixes = np.array([sector.fixes_nm[route[0]] for route in sector.routes])
    np.testing.assert_allclose(
        drawn.traffic.position_nm[:, 0], fixes[drawn.traffic.route[:, 0]], atol=1e-4
    )
    assert set(drawn.traffic.route[:, 0].tolist()) == set(range(10))
    assert drawn.traffic.own_navigation.all()


def test_observation_before_a_climb(task):
    """d_xfl is 94.85 NM to QUAIL, less 10 minutes at 288.70 kt, the time that 200 levels take."""
    observation = np.asarray(task.observe(begin(task, 100.0, 300.0)))
    to_exit_nm = 99.8437 - 4.9920
    d_xfl = to_exit_nm - 10.0 / 60.0 * 288.702
    np.testing.assert_allclose(observation, [(d_xfl + 100.0) / 200.0, 0.0, 0.0, 1.0], atol=2e-4)


def test_an_instruction_changes_the_observation_at_once(task):
    state = begin(task, 200.0, 230.0)
    instructed = task.instruct(state, action(CLIMB))
    assert float(instructed.traffic.cleared_level_ticks[0]) == ticks(210.0)
    before, after = task.observe(state), task.observe(instructed)
    assert float(after[1] - before[1]) * 400.0 == pytest.approx(10.0, abs=1e-3)
    assert float(after[3]) == 0.0
    assert (float(after[0]), float(after[2])) == (float(before[0]), float(before[2]))
    # One cycle later: 6 s of a range of 10 s.
    state, _ = task.advance(instructed)
    state, _ = task.advance(state)
    assert float(task.observe(state)[3]) == pytest.approx(0.6, abs=1e-6)


def test_cleared_levels_stay_in_the_sector(task):
    top, bottom = begin(task, 300.0, 300.0), begin(task, 100.0, 100.0)
    assert not task.may_stack(top, action(CLIMB))
    assert task.may_stack(top, action(DESCEND))
    assert not task.may_stack(bottom, action(DESCEND))
    assert float(task.instruct(top, action(CLIMB)).traffic.cleared_level_ticks[0]) == ticks(300.0)


def test_reward_is_for_the_cleared_level_and_damping(task):
    state = begin(task, 200.0, 250.0)
    _, quiet = task.step(state, action(NO_OP))
    assert float(quiet.reward[0]) == pytest.approx(np.exp(-50 / 40) - 1, abs=1e-5)
    _, instructed = task.step(state, action(CLIMB))
    assert float(instructed.reward[0]) == pytest.approx(np.exp(-40 / 40) - 1 - 0.5, abs=1e-5)


def fly_to_the_end(task, state, policy, stacked):
    """Fly a scenario. Returns the number of clearances and the last outcome."""
    clearances, advance = 0, jax.jit(task.advance)
    for _ in range(task.cycles):
        state, issued = stack(task, policy, state, limit=None if stacked else 1)
        clearances += issued.instructions > 0
        state, outcome = advance(state)
        if outcome.ended:
            break
    return clearances, outcome


def to_exit_level(observation):
    """The ideal policy: climb or descend until the cleared level is the exit level."""
    gap_fl = 400.0 * float(observation[1]) - 200.0
    return action(CLIMB if gap_fl < -5.0 else DESCEND if gap_fl > 5.0 else NO_OP)


@pytest.mark.slow
@pytest.mark.parametrize(("stacked", "clearances"), [(True, 1), (False, 15)])
def test_a_climb_of_150_levels_takes_one_or_fifteen_clearances(task, stacked, clearances):
    issued, outcome = fly_to_the_end(task, begin(task, 100.0, 250.0), to_exit_level, stacked)
    assert issued == clearances
    assert bool(outcome.metrics["success"])
    assert float(outcome.metrics["instructions"]) == 15.0


@pytest.mark.slow
def test_a_wrong_exit_level_is_not_correct_but_no_excursion(task):
    state = begin(task, 200.0, 250.0)
    _, outcome = fly_to_the_end(task, state, lambda observation: action(NO_OP), True)
    assert not bool(outcome.metrics["correct_exit"])
    assert not bool(outcome.metrics["excursion"])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"aircraft": 2}, r"task\.aircraft is 2 \(allowed for vertical: 1\)"),
        ({"actions": "small"}, r"task\.actions is small \(allowed for vertical: levels\)"),
        ({"levels_fl": (300, 100)}, r"task\.levels_fl is \[300, 100\]"),
        ({"features": ("d_xfll",)}, "did you mean 'd_xfl'"),
        ({"pair_features": ("thet",)}, "did you mean 'theta'"),
        ({"name": "lateral"}, r"task\.actions is levels \(allowed for lateral: small, large\)"),
    ],
)
def test_refuses_invalid_settings(changes, message):
    good = {"name": "vertical", "aircraft": 1, "actions": "levels", "levels_fl": (100, 300)}
    with pytest.raises(InputError, match=message):
        build_task(NavigationSettings(**(good | changes)))
