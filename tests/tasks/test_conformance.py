"""The check of the contract finds every broken promise: tasks that each break one."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import pytest

from skystack.tasks.conformance import check_task
from skystack.tasks.contract import Metric, Outcome


class Number(NamedTuple):
    value: jax.Array


METRICS = {"value": Metric("", "the number")}


class Kept:
    """A number that an action changes; keeps every promise."""

    name, version, agents = "number", 1, 1
    metrics = METRICS
    action_names, observation_names = ("none", "halve"), ("number", "its square")

    def reset(self, key):
        return Number(jax.random.uniform(key))

    def observe(self, state):
        return jnp.stack([state.value, state.value**2])

    def instruct(self, state, action):
        return Number(jnp.where(action == 1, state.value / 2.0, state.value))

    def may_stack(self, state, action):
        return action != 0

    def advance(self, state):
        no = jnp.zeros_like(state.value, dtype=bool)
        return state, Outcome(state.value[None], no[None], no[None], no, {"value": state.value})

    def step(self, state, action):
        return self.advance(self.instruct(state, action))


class Changed(Kept):
    """With other outcomes."""

    def __init__(self, **changes):
        self.changes = {name: jnp.asarray(value) for name, value in changes.items()}

    def advance(self, state):
        state, outcome = super().advance(state)
        return state, outcome._replace(**self.changes)


class RandomReset(Kept):
    def reset(self, key):
        self.calls = getattr(self, "calls", 0) + 1
        return Number(jnp.asarray(0.1 * self.calls))


class TwoOfAName(Kept):
    action_names = ("none", "none")


class ThreeValues(Kept):
    observation_names = ("number", "its square", "its cube")


class NotANumber(Kept):
    def observe(self, state):
        return super().observe(state).at[1].set(jnp.nan)


class TooGreat(Kept):
    def observe(self, state):
        return super().observe(state).at[1].set(1.01)


class TooSmall(Kept):
    def observe(self, state):
        return super().observe(state).at[1].set(-0.01)


class StepRounds(Kept):
    def step(self, state, action):
        state, outcome = super().step(state, action)
        return Number(state.value.astype(jnp.int32)), outcome


class InstructWidens(Kept):
    def instruct(self, state, action):
        return Number(state.value[None])

    def step(self, state, action):
        return self.advance(state)


class BreaksAtTwo(Kept):
    """Counts its steps, and shows no number after the second."""

    def reset(self, key):
        return Number(jnp.asarray(0.0))

    def observe(self, state):
        return jnp.stack([jnp.where(state.value < 2.0, 0.5, jnp.nan), 0.5])

    def step(self, state, action):
        state, outcome = self.advance(state)
        return Number(state.value + 1.0), outcome


class OtherMetrics(Kept):
    metrics = METRICS | {"more": Metric("", "something else")}


class StacksNothing(Kept):
    def may_stack(self, state, action):
        return action == 0


@pytest.mark.parametrize(
    "task", [Kept(), Changed(terminated=[True]), Changed(truncated=[True], ended=True)]
)
def test_a_task_that_breaks_no_promise(task):
    check_task(task, steps=3)


@pytest.mark.parametrize(
    ("task", "broken"),
    [
        (RandomReset(), "reset is not a function of its key"),
        (TwoOfAName(), "action names repeat"),
        (ThreeValues(), "observation does not fit its names"),
        (NotANumber(), "observation is not finite"),
        (TooGreat(), r"observation is not in \[0, 1\]"),
        (TooSmall(), r"observation is not in \[0, 1\]"),
        (StepRounds(), "step changes the shape or type of the state"),
        (InstructWidens(), "instruct changes shapes or types"),
        (Changed(reward=[jnp.inf]), "reward is not finite"),
        (Changed(terminated=[True], truncated=[True]), "an agent is terminated and truncated"),
        (Changed(reward=1.0), "rewards or ends have no axis of agents"),
        (Changed(ended=True), "the scenario has ended, an agent has not"),
        (OtherMetrics(), "metrics are not those specified"),
        (StacksNothing(), "may_stack allows action 0, which is no instruction"),
    ],
)
def test_a_broken_promise_is_named(task, broken):
    with pytest.raises(AssertionError, match=f"^{broken}$"):
        check_task(task, steps=3)


def test_as_many_steps_are_tried_as_asked():
    """The state after the last of them is not looked at."""
    check_task(BreaksAtTwo(), steps=2)
    with pytest.raises(AssertionError, match="observation is not finite"):
        check_task(BreaksAtTwo(), steps=3)
