"""Fly scenarios on another simulator: same policy, stacking and task, different `advance`."""

from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from skystack.compilation.fetch import fetched
from skystack.compilation.shared import shared_program
from skystack.errors import PlatformError, error_context
from skystack.evaluation.hosted import AgentController, Decisions, QueryContext
from skystack.evaluation.rollout import (
    Controller,
    Recording,
    TracedPolicy,
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
from skystack.tasks.contract import Outcome, TaskState, TrafficTask
from skystack.tasks.plain import checked_action


class PlatformRollout(NamedTuple):
    """Everything that a process needs to fly scenarios; picklable."""

    task: TrafficTask
    controller: Callable[[], Controller | AgentController]
    """Creates the controller in the process."""
    stacking: bool
    seed: int
    open_platform: Callable[[Path], Platform]


class Pilot:
    """A platform and the compiled parts of a controller's loop."""

    def __init__(self, job: PlatformRollout, folder: Path) -> None:
        self._job, self._task = job, job.task
        self._platform = job.open_platform(folder)
        self._decide = _decision(self._task, job.controller(), None if job.stacking else 1)

        self._reset = shared_program(self._task.reset)
        self._end_cycle = shared_program(_end_cycle, self._task)
        self._exit_levels = shared_program(self._task.exit_level_ticks)
        self._status = shared_program(self._task.status)
        self._compile()

    def _compile(self) -> None:
        """Compile everything before anything is timed."""
        key = scenario_key(self._job.seed, 0)
        state = fetched(self._reset(key))
        self._exit_levels(state), self._status(state)
        instructed, stack = self._decide(state, key, 0, 0)
        self._end_cycle(instructed, stack, jax.tree.map(jnp.asarray, self._task.traffic(state)))

    def fly(self, number: int) -> Recording:
        """Fly a scenario to its end. Raises InputError, which names it, and PlatformError."""
        with error_context(f"scenario {number}"):
            report, state = self._begin(number)
        return self._fly(number, report, state)

    def _begin(self, number: int) -> tuple[Report, TaskState]:
        task = self._task
        state: TaskState = fetched(self._reset(scenario_key(self._job.seed, number)))
        scenario = scenario_of(
            task.traffic(state),
            task.simulator,
            task.performance,
            task.cycles,
            callsigns(task.aircraft),
            np.asarray(self._exit_levels(state)),
        )
        return self._platform.reset(scenario), state

    def _fly(self, number: int, report: Report, state: TaskState) -> Recording:
        task, plane = self._task, self._task.sector.plane
        start = traffic_of(report, task.traffic(state), plane)
        state = task.with_traffic(state, start)
        initial = jax.tree.map(
            lambda values: np.asarray(values)[None],
            (start, self._exit_levels(state), self._status(state)),
        )
        rows: list[tuple[Any, ...]] = []
        for cycle, key in enumerate(query_keys(task, scenario_key(self._job.seed, number))):
            instructed, stack = self._decide(state, key, number, cycle)
            with error_context(f"scenario {number}, cycle {cycle}"):
                if stack.instructions > 0:
                    self._issue(task.traffic(instructed), stack)
                flown = traffic_of(self._platform.advance(), task.traffic(instructed), plane)
            state, outcome, row = fetched(self._end_cycle(instructed, stack, flown))
            rows.append(jax.tree.map(lambda values: np.asarray(values)[None], row))
            if outcome.ended:
                break
        numbers = np.array([number], dtype=np.int32)
        return recording_of(numbers, initial, rows, task.cycles)

    def _issue(self, instructed: Traffic, stack: Stack) -> None:
        action = self._task.actions[int(stack.action)]
        assert action.aircraft is not None, "an issued action addresses an aircraft"
        aircraft = action.aircraft
        callsign = callsigns(self._task.aircraft)[aircraft]
        if action.kind == "level":
            cleared_fl = int(np.rint(instructed.cleared_level_ticks[aircraft] / TICKS_PER_FL))
            instruction = Instruction(callsign, level_fl=cleared_fl)
        else:
            cleared_deg = int(np.rint(instructed.cleared_heading_deg[aircraft])) % 360
            instruction = Instruction(callsign, heading_deg=cleared_deg)
        self._platform.issue(instruction)


DecideOne = Callable[[TaskState, PRNGKeyArray, int, int], tuple[TaskState, Stack]]
"""Issues a stack of instructions: (state, key, scenario number, cycle) -> (state, stack)."""


def _decision(
    task: TrafficTask, controller: Controller | AgentController, limit: int | None
) -> DecideOne:
    """The function that stacks a controller's instructions in one scenario.

    It raises InputError, which names the scenario, for an invalid action.
    """
    if isinstance(controller, AgentController):
        decisions = Decisions(task, controller, limit)

        def query(
            state: TaskState, key: PRNGKeyArray, number: int, cycle: int
        ) -> tuple[TaskState, Stack]:
            moment = QueryContext(np.array([number], dtype=np.int32), cycle, key[None])
            batch = jax.tree.map(lambda values: np.asarray(values)[..., None], state)
            decided = decisions.decide(batch, np.ones(1, dtype=bool), moment)
            unbatched: tuple[TaskState, Stack] = jax.tree.map(
                lambda values: np.asarray(values)[..., 0], decided
            )
            return unbatched

        return query
    weights, program = controller.weights, shared_program(_decided, task, controller.decide, limit)

    def decide(
        state: TaskState, key: PRNGKeyArray, number: int, cycle: int
    ) -> tuple[TaskState, Stack]:
        instructed, stack = fetched(program(weights, state, key))
        with error_context(f"scenario {number}, cycle {cycle}"):
            checked_action(stack.action, len(task.action_names))
        return instructed, stack

    return decide


def _decided(
    task: TrafficTask,
    decide: TracedPolicy,
    limit: int | None,
    weights: Any,
    state: TaskState,
    key: PRNGKeyArray,
) -> tuple[TaskState, Stack]:
    return stack_traced(task, partial(decide, weights), state, key, limit)


def _end_cycle(
    task: TrafficTask, instructed: TaskState, stack: Stack, flown: Traffic
) -> tuple[TaskState, Outcome, tuple[Any, ...]]:
    state, outcome = task.end_cycle(instructed, flown)
    row = keep(task, stack, state, outcome, jnp.zeros((), dtype=bool))
    return state, outcome, row


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
    """Fly scenarios 0, 1, ... in one process per core and yield them in blocks.

    Platforms write into `folder`. Scenarios that are not finished are in no block; the reason is
    added to `failed`. Raises InputError for a scenario that the platform cannot fly, PlatformError
    if no scenario was finished.
    """
    finished, part = list[Recording](), scenarios_in_part(job.task)
    outcomes = in_processes(partial(_pilot, job), range(scenarios), folder, time_limit_s)
    with closing(outcomes):
        for number, outcome in enumerate(outcomes):
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
