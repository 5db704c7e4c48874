"""Steps a second of the simulator with all that a learner needs: observations, rewards, resets.

Everybody speaks at random: one instruction in ten steps. A step is one radar cycle of one scenario.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from skystack.benchmarking.figures import Figure, rates
from skystack.compilation.programs import compile_for_one_core
from skystack.learning.experiment import load_experiment
from skystack.simulator.generator import Crowd
from skystack.tasks.actions import small_turns
from skystack.tasks.batch import choose, reset_many
from skystack.tasks.build import build_task
from skystack.tasks.contract import Task

AIRCRAFT_AT_ONCE = 4096
STEPS = 64


def simulator_figures(numbers: Sequence[int], repetitions: int) -> list[Figure]:
    """Steps a second for each number of aircraft, and what one aircraft-step costs."""
    compile_for_one_core()
    figures = []
    for aircraft in numbers:
        scenarios = max(AIRCRAFT_AT_ONCE // aircraft, 16)
        stepper = Stepper(task_of(aircraft), scenarios)
        found = rates(stepper.run, scenarios * STEPS, repetitions)
        how = (
            f"the state and the rewards of `lateral`, {aircraft} aircraft, {scenarios} scenarios "
            f"at once, {STEPS} steps a call, one process"
        )
        figures.append(Figure(f"simulator, {aircraft} aircraft", "steps/s", found, how))
        cost = tuple(1e9 / (rate * aircraft) for rate in found)
        figures.append(Figure(f"one aircraft-step, {aircraft} aircraft", "ns", cost, how))
    return figures


def task_of(aircraft: int) -> Task:
    """The lateral task for any number of aircraft, spread over the routes if there are many."""
    task = build_task(load_experiment("lateral").task)
    if aircraft == task.scenarios.aircraft:
        return task
    crowd = Crowd(task.simulator, aircraft)
    return replace(task, scenarios=crowd, actions=small_turns(aircraft))


@dataclass
class Stepper:
    """A batch of scenarios that goes on from call to call."""

    task: Task
    scenarios: int

    def __post_init__(self) -> None:
        self._key = jax.random.key(0)
        self.state = jax.jit(lambda key: reset_many(self.task, key, self.scenarios))(self._key)
        self._compiled = jax.jit(self._steps, donate_argnums=0)

    def run(self) -> None:
        """`STEPS` steps of every scenario."""
        self._key, key = jax.random.split(self._key)
        self.state, seen = self._compiled(self.state, key)
        jax.device_get(seen)

    def _steps(self, state: Any, key: PRNGKeyArray) -> tuple[Any, Any]:
        fresh_key, speak_key, action_key = jax.random.split(key, 3)
        fresh = reset_many(self.task, fresh_key, self.scenarios)
        shape = (STEPS, self.scenarios)
        speaks = jax.random.uniform(speak_key, shape) < 0.1
        actions = jax.random.randint(action_key, shape, 0, len(self.task.action_names))

        def step(carry: tuple[Any, Any], action: Any) -> tuple[tuple[Any, Any], Any]:
            state, outcome = self.task.step(carry[0], action)
            state = choose(outcome.terminated | outcome.truncated, fresh, state)
            return (state, self.task.observe(state)), (outcome.reward, outcome.terminated)

        start = (state, self.task.observe(state))
        (state, observation), judged = jax.lax.scan(step, start, jnp.where(speaks, actions, 0))
        return state, (observation, judged)
