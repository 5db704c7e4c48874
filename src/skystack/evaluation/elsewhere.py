"""Fly scenarios on another simulator: the same policy, stacking and task, another `advance`.

Each process has one platform and flies one scenario after another. A scenario that takes too long,
or whose process dies, is given up and named; the others are finished in a new process.
"""

import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import TimeoutError as OutOfTime
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from skystack.errors import InputError, PlatformError
from skystack.evaluation.rollout import Controller, Recording, keep, query_keys, together
from skystack.evaluation.tables import callsigns
from skystack.platforms.conversion import scenario_of, traffic_of
from skystack.platforms.instruction import worded
from skystack.platforms.protocol import Platform, Report
from skystack.seeds import scenario_key
from skystack.simulator.traffic import Traffic
from skystack.stacking import Stack, stack_traced
from skystack.tasks.contract import Outcome
from skystack.tasks.lateral import LateralState, LateralTask

TIME_LIMIT_S = 120.0
"""For one scenario."""


class Job(NamedTuple):
    """What a process needs to fly scenarios; picklable."""

    task: LateralTask
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

        def decide(state: LateralState, key: PRNGKeyArray) -> tuple[LateralState, Stack]:
            return stack_traced(self._task, policy, state, key, limit)

        def judge(
            told: LateralState, stack: Stack, flown: Traffic
        ) -> tuple[LateralState, Outcome, tuple[Any, ...]]:
            state, outcome = self._task.judge(told.memory, flown)
            kept = keep(told, stack, state, outcome, jnp.zeros((), dtype=bool))
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
        """One scenario to its end. Raises InputError and PlatformError."""
        task, plane = self._task, self._task.simulator.sector.plane
        key = scenario_key(self._job.seed, number)
        state: LateralState = jax.device_get(self._reset(key))
        scenario = scenario_of(
            state.traffic,
            task.simulator,
            task.settings.performance,
            task.settings.cycles,
            callsigns(task),
        )
        report = _finite(_ask(self._platform.reset, scenario))
        start = traffic_of(report, state.traffic, plane)
        state = state._replace(traffic=start)
        rows = []
        for query in query_keys(task, key):
            told, stack = jax.device_get(self._decide(state, query))
            if stack.instructions > 0:
                self._issue(told.traffic, stack)
            flown = traffic_of(_finite(_ask(self._platform.advance)), told.traffic, plane)
            state, outcome, kept = jax.device_get(self._judge(told, stack, flown))
            rows.append(kept)
            if outcome.terminated:
                break
        return _recording(number, start, rows, task.settings.cycles)

    def _issue(self, told: Traffic, stack: Stack) -> None:
        aircraft = self._task.actions.turns[int(stack.action) - 1][0]
        instruction = worded(
            callsigns(self._task)[aircraft],
            int(np.rint(told.cleared_heading_deg[aircraft])) % 360,
            None,
            float(told.heading_deg[aircraft]),
            actual_fl=0.0,
        )
        _ask(self._platform.issue, instruction)


Answer = TypeVar("Answer")


def _ask(question: Callable[..., Answer], *arguments: Any) -> Answer:
    """Call a platform; whatever it raises beside our own errors is its failure."""
    try:
        return question(*arguments)
    except (InputError, PlatformError):
        raise
    except Exception as error:
        raise PlatformError(f"failed: {type(error).__name__}: {error}") from error


def _finite(report: Report) -> Report:
    if not np.all(np.isfinite(report)):
        raise PlatformError("reported a number that is not finite")
    return report


def _recording(
    number: int, start: Traffic, rows: Sequence[tuple[Any, ...]], cycles: int
) -> Recording:
    """Rows of one scenario as a recording of full length: the last repeats, but nothing happens."""
    missing = cycles - len(rows)
    kept = jax.tree.map(lambda *values: np.stack([*values, *values[-1:] * missing])[None], *rows)
    recording = Recording(
        np.array([number], dtype=np.int32), jax.tree.map(lambda row: row[None], start), *kept
    )
    ran = np.arange(cycles) < len(rows)
    return recording._replace(
        instructions=np.where(ran, recording.instructions, 0),
        ran=ran[None],
        reward=np.where(ran, recording.reward, 0.0).astype(np.float32),
        metrics=jax.tree.map(lambda values: values[:, -1], recording.metrics),
    )


_pilot: Pilot | Exception | None = None
"""The one of this process, or why there is none."""


def _begin(job: Job, folder: Path) -> None:
    """In a new process: a platform, writing into a folder of its own."""
    global _pilot  # noqa: PLW0603  (a process has one simulator)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends what is interrupted
    try:
        _pilot = Pilot(job, Path(tempfile.mkdtemp(dir=folder)))
    except Exception as error:  # told when it is asked to fly
        _pilot = error


def _fly(number: int) -> Recording:
    if not isinstance(_pilot, Pilot):
        raise _pilot or RuntimeError("the process was not begun")
    return _pilot.fly(number)


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
    from pebble import ProcessExpired, ProcessPool  # noqa: PLC0415  (comes with the platforms)

    recordings, failed = [], {}
    with ProcessPool(
        max_workers=min(_cores(), scenarios),
        initializer=_begin,
        initargs=(job, folder),
        context=multiprocessing.get_context("spawn"),
    ) as pool:
        futures = [
            pool.schedule(_fly, args=(number,), timeout=time_limit_s) for number in range(scenarios)
        ]
        try:
            for number, future in enumerate(futures):
                try:
                    recordings.append(future.result())
                except OutOfTime:
                    failed[number] = f"took more than {time_limit_s:.0f} s"
                except ProcessExpired as expired:
                    failed[number] = f"the simulator's process died (exit code {expired.exitcode})"
                except PlatformError as error:
                    failed[number] = str(error)
                on_scenario(number + 1)
        except BaseException:
            pool.stop()
            raise
    if not recordings:
        raise PlatformError(f"no scenario was finished: scenario 0 {failed[0]}")
    return FlownElsewhere(together(recordings), failed)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
