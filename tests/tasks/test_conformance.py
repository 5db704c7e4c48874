"""`check_task` detects every violation of the contract, in tasks that each violate one rule."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import pytest

from skystack.tasks.conformance import check_task
from skystack.tasks.contract import Metric, Outcome


class Number(NamedTuple):
    value: jax.Array


METRICS = {"value": Metric("", "the number")}


class HalvingTask:
    """A number that an action halves. Satisfies the contract."""

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


class ChangedOutcome(HalvingTask):
    """The task with some fields of its outcomes replaced."""

    def __init__(self, **changes):
        self.changes = {name: jnp.asarray(value) for name, value in changes.items()}

    def advance(self, state):
        state, outcome = super().advance(state)
        return state, outcome._replace(**self.changes)


class RandomReset(HalvingTask):
    def reset(self, key):
        self.calls = getattr(self, "calls", 0) + 1
        return Number(jnp.asarray(0.1 * self.calls))


class RepeatedActionName(HalvingTask):
    action_names = ("none", "none")


class TooManyNames(HalvingTask):
    observation_names = ("number", "its square", "its cube")


class ObservesNaN(HalvingTask):
    def observe(self, state):
        return super().observe(state).at[1].set(jnp.nan)


class ObservesAboveOne(HalvingTask):
    def observe(self, state):
        return super().observe(state).at[1].set(1.01)


class ObservesBelowZero(HalvingTask):
    def observe(self, state):
        return super().observe(state).at[1].set(-0.01)


class StepChangesType(HalvingTask):
    def step(self, state, action):
        state, outcome = super().step(state, action)
        return Number(state.value.astype(jnp.int32)), outcome


class InstructChangesShape(HalvingTask):
    def instruct(self, state, action):
        return Number(state.value[None])

    def step(self, state, action):
        return self.advance(state)


class ObservesNaNAfterTwoSteps(HalvingTask):
    """Counts its steps. Its observation is NaN after the second."""

    def reset(self, key):
        return Number(jnp.asarray(0.0))

    def observe(self, state):
        return jnp.stack([jnp.where(state.value < 2.0, 0.5, jnp.nan), 0.5])

    def step(self, state, action):
        state, outcome = self.advance(state)
        return Number(state.value + 1.0), outcome


class MissingMetric(HalvingTask):
    metrics = METRICS | {"more": Metric("", "something else")}


class StacksNoOp(HalvingTask):
    def may_stack(self, state, action):
        return action == 0


@pytest.mark.parametrize(
    "task",
    [
        HalvingTask(),
        ChangedOutcome(terminated=[True]),
        ChangedOutcome(truncated=[True], ended=True),
    ],
)
def test_accepts_a_valid_task(task):
    check_task(task, steps=3)


@pytest.mark.parametrize(
    ("task", "violation"),
    [
        (RandomReset(), "reset is not a function of its key"),
        (RepeatedActionName(), "action names repeat"),
        (TooManyNames(), "observation does not fit its names"),
        (ObservesNaN(), "observation is not finite"),
        (ObservesAboveOne(), r"observation is not in \[0, 1\]"),
        (ObservesBelowZero(), r"observation is not in \[0, 1\]"),
        (StepChangesType(), "step changes the shape or type of the state"),
        (InstructChangesShape(), "instruct changes shapes or types"),
        (ChangedOutcome(reward=[jnp.inf]), "reward is not finite"),
        (
            ChangedOutcome(terminated=[True], truncated=[True]),
            "an agent is terminated and truncated",
        ),
        (ChangedOutcome(reward=1.0), "rewards or ends have no axis of agents"),
        (ChangedOutcome(ended=True), "the scenario has ended, an agent has not"),
        (MissingMetric(), "metrics are not those specified"),
        (StacksNoOp(), "may_stack allows action 0, which is no instruction"),
    ],
)
def test_states_the_violated_rule(task, violation):
    with pytest.raises(AssertionError, match=f"^{violation}$"):
        check_task(task, steps=3)


def test_runs_the_requested_number_of_steps():
    """The observation after the last step is not checked."""
    check_task(ObservesNaNAfterTwoSteps(), steps=2)
    with pytest.raises(AssertionError, match="observation is not finite"):
        check_task(ObservesNaNAfterTwoSteps(), steps=3)
