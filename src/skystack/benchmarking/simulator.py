"""Steps per second of the simulator with all that a learner needs: observations, rewards, resets.

Actions are random, with an instruction in one step out of ten. A step is one radar cycle of one
scenario.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from skystack.benchmarking.figures import Figure, rates
from skystack.compilation.programs import compile_for_cores
from skystack.simulator.crowd import Crowd
from skystack.tasks.actions import small_turns
from skystack.tasks.batch import choose, reset_many
from skystack.tasks.contract import Task
from skystack.tasks.navigation_kinds import build_navigation
from skystack.tasks.settings import NavigationSettings

AIRCRAFT_AT_ONCE = 4096
STEPS = 64


def simulator_figures(numbers: Sequence[int], repetitions: int) -> list[Figure]:
    """Steps per second for each number of aircraft, and the time of one aircraft-step."""
    compile_for_cores(1)
    figures = []
    for aircraft in numbers:
        scenarios = max(AIRCRAFT_AT_ONCE // aircraft, 16)
        stepper = Stepper(task_of(aircraft), scenarios)
        speeds = rates(stepper.run, scenarios * STEPS, repetitions)
        setup = (
            f"the state and the rewards of `lateral`, {aircraft} aircraft, {scenarios} scenarios "
            f"at once, {STEPS} steps per call, one process"
        )
        figures.append(Figure(f"simulator, {aircraft} aircraft", "steps/s", speeds, setup))
        cost = tuple(1e9 / (speed * aircraft) for speed in speeds)
        figures.append(Figure(f"one aircraft-step, {aircraft} aircraft", "ns", cost, setup))
    return figures


def task_of(aircraft: int) -> Task:
    """The lateral task with any number of aircraft; many are spread over the routes."""
    task = build_navigation(NavigationSettings())
    if aircraft == task.aircraft:
        return task
    crowd = Crowd(task.simulator, aircraft)
    return replace(task, scenarios=crowd, table=small_turns(aircraft))


@dataclass
class Stepper:
    """A batch of scenarios that continues from call to call."""

    task: Task
    scenarios: int

    def __post_init__(self) -> None:
        self._key = jax.random.key(0)
        self.state = jax.jit(lambda key: reset_many(self.task, key, self.scenarios))(self._key)
        self._compiled = jax.jit(self._steps, donate_argnums=0)

    def run(self) -> None:
        """`STEPS` steps of every scenario."""
        self._key, key = jax.random.split(self._key)
        self.state, results = self._compiled(self.state, key)
        jax.device_get(results)

    def _steps(self, state: Any, key: PRNGKeyArray) -> tuple[Any, Any]:
        fresh_key, instruct_key, action_key = jax.random.split(key, 3)
        fresh = reset_many(self.task, fresh_key, self.scenarios)
        shape = (STEPS, self.scenarios)
        instructs = jax.random.uniform(instruct_key, shape) < 0.1
        actions = jax.random.randint(action_key, shape, 0, len(self.task.action_names))

        def step(carry: tuple[Any, Any], action: Any) -> tuple[tuple[Any, Any], Any]:
            state, outcome = self.task.step(carry[0], action)
            state = choose(outcome.ended, fresh, state)
            return (state, self.task.observe(state)), (outcome.reward, outcome.terminated)

        start = (state, self.task.observe(state))
        actions = jnp.where(instructs, actions, 0)
        (state, observation), outcomes = jax.lax.scan(step, start, actions)
        return state, (observation, outcomes)
