"""Absolute clearances and large changes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.learning.experiment import load_experiment
from skystack.tasks.registry import build_task
from studies.neighbours.absolute import with_absolute_actions, with_large_changes


@pytest.fixture(scope="module")
def headings():
    return with_absolute_actions(build_task(load_experiment("lateral").task), 10)


@pytest.fixture(scope="module")
def levels():
    return with_absolute_actions(build_task(load_experiment("vertical").task), 10)


def action(task, name):
    return jnp.asarray(task.action_names.index(name))


def test_has_every_heading_or_level_for_each_aircraft(headings, levels):
    assert len(headings.action_names) == 1 + 2 * 36
    assert headings.action_names[1:3] == ("aircraft 1 heading 000", "aircraft 1 heading 010")
    assert levels.action_names == (
        "none",
        *(f"aircraft 1 level {level}" for level in range(100, 301, 10)),
    )
    finer = with_absolute_actions(headings.task, 5)
    assert len(finer.action_names) == 1 + 2 * 72


@pytest.mark.slow
def test_a_heading_is_cleared_once(headings):
    """The same heading again is not an instruction; no other aircraft turns."""
    state = headings.reset(jax.random.key(1))
    before = state.traffic.cleared_heading_deg
    second = action(headings, "aircraft 2 heading 240")
    assert bool(headings.may_stack(state, second))
    state = headings.instruct(state, second)
    assert state.traffic.cleared_heading_deg.tolist() == [float(before[0]), 240.0]
    assert not bool(headings.may_stack(state, second))
    state, outcome = headings.step(state, second)
    assert float(outcome.metrics["instructions"]) == 1.0
    for _ in range(40):
        state, _ = headings.step(state, jnp.asarray(0))
    assert float(state.traffic.heading_deg[1]) == 240.0


@pytest.mark.slow
def test_a_level_is_cleared_once(levels):
    state = levels.reset(jax.random.key(1))
    climb = action(levels, "aircraft 1 level 250")
    state, _ = levels.step(state, climb)
    state, outcome = levels.step(state, climb)
    assert float(outcome.metrics["instructions"]) == 1.0
    assert float(state.traffic.cleared_level_ticks[0]) == 250.0 * 6000.0


def test_observes_the_cleared_values_in_range(headings, levels):
    for task in (headings, levels):
        state = task.reset(jax.random.key(2))
        observation = task.observe(state)
        assert observation.shape == (len(task.observation_names),)
        assert bool(((observation >= 0.0) & (observation <= 1.0)).all())
    state = headings.instruct(
        headings.reset(jax.random.key(2)), action(headings, "aircraft 1 heading 090")
    )
    named = dict(zip(headings.observation_names, headings.observe(state).tolist(), strict=True))
    assert named["sin heading 1"] == pytest.approx(1.0)
    assert named["cos heading 1"] == pytest.approx(0.5)
    assert named["cleared level 2"] == pytest.approx(0.5)  # FL300 of FL600
    assert named["exit level 2"] == pytest.approx(0.5)


def test_observes_the_bearing_to_the_next_fix(headings):
    """The bearing does not depend on the clearance and agrees with plane geometry."""
    state = headings.reset(jax.random.key(4))
    sector, traffic = headings.task.sector, state.traffic
    fix = sector.fixes_nm[sector.routes[int(traffic.route[0])][1]]
    east, north = fix - np.asarray(traffic.position_nm[0])
    distance = np.hypot(east, north)
    for heading in ("010", "270"):
        turned = headings.instruct(state, action(headings, f"aircraft 1 heading {heading}"))
        values = headings.observe(turned).tolist()
        named = dict(zip(headings.observation_names, values, strict=True))
        assert named["sin theta_f 1"] == pytest.approx(0.5 + 0.5 * east / distance, abs=1e-3)
        assert named["cos theta_f 1"] == pytest.approx(0.5 + 0.5 * north / distance, abs=1e-3)


def test_large_changes_are_the_papers_37_actions():
    lateral = build_task(load_experiment("lateral").task)
    large = build_task(load_experiment("lateral-large").task)
    assert with_large_changes(lateral, range(10, 91, 10)).action_names == large.action_names
    vertical = with_large_changes(build_task(load_experiment("vertical").task), range(10, 91, 10))
    assert len(vertical.action_names) == 19
    state = vertical.reset(jax.random.key(0))
    before = float(state.traffic.cleared_level_ticks[0]) / 6000.0
    down = vertical.instruct(state, action(vertical, "aircraft 1 level -40 FL"))
    expected = max(before - 40.0, 100.0)
    assert float(down.traffic.cleared_level_ticks[0]) / 6000.0 == expected
