"""Fly scenarios on another simulator: the same policy, stacking and task, another `advance`."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray
from numpy.typing import ArrayLike

from skystack.errors import InputError, PlatformError
from skystack.evaluation.rollout import Controller, Recording, keep, query_keys, together
from skystack.platforms.conversion import scenario_of, traffic_of
from skystack.platforms.instruction import Instruction
from skystack.platforms.processes import TIME_LIMIT_S, in_processes
from skystack.platforms.protocol import Platform
from skystack.seeds import scenario_key
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import Traffic, callsigns
from skystack.stacking import Stack, stack_traced
from skystack.tasks.contract import Outcome
from skystack.tasks.navigation import NavigationState, NavigationTask
from skystack.tasks.plain import checked_action


class Job(NamedTuple):
    """What a process needs to fly scenarios; picklable."""

    task: NavigationTask
    controller: Callable[[], Controller]
    """Makes the controller, in the process."""
    stacking: bool
    seed: int
    open_platform: Callable[[Path], Platform]


class FlownElsewhere(NamedTuple):
    """What came of it."""

    recording: Recording
    """Of the scenarios that were finished, in order."""
    failed: dict[int, str]
    """Why the others were not."""


class Pilot:
    """One platform and the compiled parts of one controller's loop."""

    def __init__(self, job: Job, folder: Path) -> None:
        self._job, self._task = job, job.task
        self._platform = job.open_platform(folder)
        controller = job.controller()
        policy = partial(controller.decide, controller.weights)
        limit = None if job.stacking else 1

        def decide(state: NavigationState, key: PRNGKeyArray) -> tuple[NavigationState, Stack]:
            return stack_traced(self._task, policy, state, key, limit)

        def judge(
            told: NavigationState, stack: Stack, flown: Traffic
        ) -> tuple[NavigationState, Outcome, tuple[Any, ...]]:
            state, outcome = self._task.judge(told.memory, flown)
            kept = keep(stack, state, outcome, jnp.zeros((), dtype=bool))
            return state, outcome, kept

        self._reset = jax.jit(self._task.reset)
        self._decide, self._judge = jax.jit(decide), jax.jit(judge)
        self._compile()

    def _compile(self) -> None:
        """All that is compiled, before anything is timed."""
        key = scenario_key(self._job.seed, 0)
        state = jax.device_get(self._reset(key))
        told, stack = jax.device_get(self._decide(state, key))
        self._judge(told, stack, jax.tree.map(jnp.asarray, state.traffic))

    def fly(self, number: int) -> Recording:
        """One scenario to its end. Raises InputError, which names it, and PlatformError."""
        try:
            return self._fly(number)
        except InputError as error:
            raise InputError(f"scenario {number}: {error}") from None

    def _fly(self, number: int) -> Recording:
        task, plane = self._task, self._task.simulator.sector.plane
        key = scenario_key(self._job.seed, number)
        state: NavigationState = jax.device_get(self._reset(key))
        scenario = scenario_of(
            state.traffic,
            task.simulator,
            task.settings.performance,
            task.settings.cycles,
            callsigns(task.scenarios.aircraft),
            state.memory.exit_level,
        )
        report = self._platform.reset(scenario)
        start = traffic_of(report, state.traffic, plane)
        state = state._replace(traffic=start)
        rows = []
        for query in query_keys(task, key):
            told, stack = jax.device_get(self._decide(state, query))
            checked_action(stack.action, len(task.action_names))
            if stack.instructions > 0:
                self._issue(told.traffic, stack)
            flown = traffic_of(self._platform.advance(), told.traffic, plane)
            state, outcome, kept = jax.device_get(self._judge(told, stack, flown))
            rows.append(kept)
            if outcome.terminated:
                break
        return _recording(number, start, state.memory.exit_level, rows, task.settings.cycles)

    def _issue(self, told: Traffic, stack: Stack) -> None:
        actions = self._task.actions
        aircraft = actions.changes[int(stack.action) - 1][0]
        callsign = callsigns(self._task.scenarios.aircraft)[aircraft]
        if actions.kind == "level":
            cleared_fl = int(np.rint(told.cleared_level[aircraft] / TICKS_PER_FL))
            instruction = Instruction(callsign, level_fl=cleared_fl)
        else:
            cleared_deg = int(np.rint(told.cleared_heading_deg[aircraft])) % 360
            instruction = Instruction(callsign, heading_deg=cleared_deg)
        self._platform.issue(instruction)


def _recording(
    number: int,
    start: Traffic,
    exit_level: ArrayLike,
    rows: Sequence[tuple[Any, ...]],
    cycles: int,
) -> Recording:
    """Rows of one scenario as a recording of full length: the last repeats, but nothing happens."""
    missing = cycles - len(rows)
    kept = jax.tree.map(lambda *values: np.stack([*values, *values[-1:] * missing])[None], *rows)
    recording = Recording(
        np.array([number], dtype=np.int32),
        jax.tree.map(lambda row: row[None], start),
        np.asarray(exit_level)[None],
        *kept,
    )
    ran = np.arange(cycles) < len(rows)
    return recording._replace(
        instructions=np.where(ran, recording.instructions, 0),
        ran=ran[None],
        reward=np.where(ran, recording.reward, 0.0).astype(np.float32),
        metrics=jax.tree.map(lambda values: values[:, -1], recording.metrics),
    )


def _pilot(job: Job, folder: Path) -> Callable[[int], Recording]:
    return Pilot(job, folder).fly


def fly_elsewhere(
    job: Job,
    scenarios: int,
    folder: Path,
    time_limit_s: float = TIME_LIMIT_S,
    on_scenario: Callable[[int], None] = lambda done: None,
) -> FlownElsewhere:
    """Fly scenarios 0, 1, ... in one process a core; platforms write into `folder`.

    Raises InputError for a scenario that the platform cannot fly, PlatformError when no scenario
    was finished.
    """
    done = in_processes(partial(_pilot, job), range(scenarios), folder, time_limit_s, on_scenario)
    if not done.results:
        raise PlatformError(f"no scenario was finished: scenario 0 {done.failed[0]}")
    return FlownElsewhere(together(list(done.results.values())), done.failed)
