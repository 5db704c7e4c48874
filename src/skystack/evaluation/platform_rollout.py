"""Fly scenarios on another simulator: the same policy, stacking and task, another `advance`."""

from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from skystack.errors import PlatformError, error_context
from skystack.evaluation.hosted import Decisions, HostedController, Moment
from skystack.evaluation.rollout import (
    Controller,
    Recording,
    concatenate,
    keep,
    query_keys,
    recording_of,
    scenarios_in_part,
)
from skystack.learning.seeds import scenario_key
from skystack.platforms.conversion import scenario_of, traffic_of
from skystack.platforms.instruction import Instruction
from skystack.platforms.processes import TIME_LIMIT_S, in_processes
from skystack.platforms.protocol import Platform, Report
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import Traffic, callsigns
from skystack.stacking import Stack, stack_traced
from skystack.tasks.contract import Outcome
from skystack.tasks.navigation import NavigationState, NavigationTask
from skystack.tasks.plain import checked_action


class PlatformRollout(NamedTuple):
    """What a process needs to fly scenarios; picklable."""

    task: NavigationTask
    controller: Callable[[], Controller | HostedController]
    """Makes the controller, in the process."""
    stacking: bool
    seed: int
    open_platform: Callable[[Path], Platform]


class Pilot:
    """One platform and the compiled parts of one controller's loop."""

    def __init__(self, job: PlatformRollout, folder: Path) -> None:
        self._job, self._task = job, job.task
        self._platform = job.open_platform(folder)
        self._decide = _decision(self._task, job.controller(), None if job.stacking else 1)

        def judge(
            told: NavigationState, stack: Stack, flown: Traffic
        ) -> tuple[NavigationState, Outcome, tuple[Any, ...]]:
            state, outcome = self._task.judge(told.memory, flown)
            kept = keep(stack, state, outcome, jnp.zeros((), dtype=bool))
            return state, outcome, kept

        self._reset, self._judge = jax.jit(self._task.reset), jax.jit(judge)
        self._compile()

    def _compile(self) -> None:
        """All that is compiled, before anything is timed."""
        key = scenario_key(self._job.seed, 0)
        state = jax.device_get(self._reset(key))
        told, stack = self._decide(state, key, 0, 0)
        self._judge(told, stack, jax.tree.map(jnp.asarray, state.traffic))

    def fly(self, number: int) -> Recording:
        """One scenario to its end. Raises InputError, which names it, and PlatformError."""
        with error_context(f"scenario {number}"):
            report, state = self._begin(number)
        return self._fly(number, report, state)

    def _begin(self, number: int) -> tuple[Report, NavigationState]:
        task = self._task
        state: NavigationState = jax.device_get(self._reset(scenario_key(self._job.seed, number)))
        scenario = scenario_of(
            state.traffic,
            task.simulator,
            task.settings.performance,
            task.settings.cycles,
            callsigns(task.scenarios.aircraft),
            state.memory.exit_level_ticks,
        )
        return self._platform.reset(scenario), state

    def _fly(self, number: int, report: Report, state: NavigationState) -> Recording:
        task, plane = self._task, self._task.simulator.sector.plane
        start = traffic_of(report, state.traffic, plane)
        state = state._replace(traffic=start)
        rows: list[tuple[Any, ...]] = []
        for cycle, key in enumerate(query_keys(task, scenario_key(self._job.seed, number))):
            told, stack = self._decide(state, key, number, cycle)
            with error_context(f"scenario {number}, cycle {cycle}"):
                if stack.instructions > 0:
                    self._issue(told.traffic, stack)
                flown = traffic_of(self._platform.advance(), told.traffic, plane)
            state, outcome, kept = jax.device_get(self._judge(told, stack, flown))
            rows.append(jax.tree.map(lambda values: np.asarray(values)[None], kept))
            if outcome.terminated:
                break
        start, exit_level_ticks = jax.tree.map(
            lambda values: np.asarray(values)[None], (start, state.memory.exit_level_ticks)
        )
        numbers = np.array([number], dtype=np.int32)
        return recording_of(numbers, start, exit_level_ticks, rows, task.settings.cycles)

    def _issue(self, told: Traffic, stack: Stack) -> None:
        actions = self._task.actions
        aircraft = actions.changes[int(stack.action) - 1][0]
        callsign = callsigns(self._task.scenarios.aircraft)[aircraft]
        if actions.kind == "level":
            cleared_fl = int(np.rint(told.cleared_level_ticks[aircraft] / TICKS_PER_FL))
            instruction = Instruction(callsign, level_fl=cleared_fl)
        else:
            cleared_deg = int(np.rint(told.cleared_heading_deg[aircraft])) % 360
            instruction = Instruction(callsign, heading_deg=cleared_deg)
        self._platform.issue(instruction)


DecideOne = Callable[[NavigationState, PRNGKeyArray, int, int], tuple[NavigationState, Stack]]
"""Stacks what a controller asks for: (state, key, number of the scenario, cycle)."""


def _decision(
    task: NavigationTask, controller: Controller | HostedController, limit: int | None
) -> DecideOne:
    """Of one scenario; raises InputError, which names it, for what is no action of the task."""
    if isinstance(controller, HostedController):
        decisions = Decisions(task, controller, limit)

        def ask(
            state: NavigationState, key: PRNGKeyArray, number: int, cycle: int
        ) -> tuple[NavigationState, Stack]:
            moment = Moment(np.array([number], dtype=np.int32), cycle, key[None])
            many = jax.tree.map(lambda values: np.asarray(values)[..., None], state)
            decided = decisions.decide(many, np.ones(1, dtype=bool), moment)
            one: tuple[NavigationState, Stack] = jax.tree.map(
                lambda values: np.asarray(values)[..., 0], decided
            )
            return one

        return ask
    policy = partial(controller.decide, controller.weights)

    @jax.jit
    def compiled(state: NavigationState, key: PRNGKeyArray) -> tuple[NavigationState, Stack]:
        return stack_traced(task, policy, state, key, limit)

    def decide(
        state: NavigationState, key: PRNGKeyArray, number: int, cycle: int
    ) -> tuple[NavigationState, Stack]:
        told, stack = jax.device_get(compiled(state, key))
        with error_context(f"scenario {number}, cycle {cycle}"):
            checked_action(stack.action, len(task.action_names))
        return told, stack

    return decide


def _pilot(job: PlatformRollout, folder: Path) -> Callable[[int], Recording]:
    return Pilot(job, folder).fly


def fly_on_platform(
    job: PlatformRollout,
    scenarios: int,
    folder: Path,
    failed: dict[int, str],
    time_limit_s: float = TIME_LIMIT_S,
    on_scenario: Callable[[int], None] = lambda done: None,
) -> Iterator[Recording]:
    """Fly scenarios 0, 1, ... in one process a core, block by block; platforms write into `folder`.

    Scenarios that are not finished are in no block: why not is put into `failed`. Raises InputError
    for a scenario that the platform cannot fly, PlatformError when no scenario was finished.
    """
    finished, part = list[Recording](), scenarios_in_part(job.task)
    flying = in_processes(partial(_pilot, job), range(scenarios), folder, time_limit_s)
    with closing(flying):
        for number, outcome in enumerate(flying):
            if outcome.failed is None:
                finished.append(outcome.result)
            else:
                failed[number] = outcome.failed
            on_scenario(number + 1)
            if len(finished) == part or (finished and number == scenarios - 1):
                yield concatenate(finished)
                finished = []
    if len(failed) == scenarios:
        raise PlatformError(f"no scenario was finished: scenario 0 {failed[0]}")
