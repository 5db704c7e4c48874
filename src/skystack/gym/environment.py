"""One scenario at a time as a Gymnasium environment, with `step` or with its two phases."""

from collections.abc import Mapping
from typing import Any, TypeVar

import gymnasium
import jax
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from jaxtyping import Float, PRNGKeyArray, UInt8

from skystack.compilation.forks import refuse_forked
from skystack.errors import InputError
from skystack.gym.radar import Radar
from skystack.tasks.contract import Outcome, Task, TaskState
from skystack.tasks.plain import PlainState, PlainTask

Observation = Float[np.ndarray, " observation"]
Info = dict[str, Any]
Started = TypeVar("Started")

RENDER_MODES = ("rgb_array",)
FRAMES_PER_S = 10


class TaskEnvironment(gymnasium.Env[Observation, np.int64]):
    """Any task as a Gymnasium environment.

    Observations are float32 values in [0, 1], actions are indices into the task's action table, and
    rewards are the task's own, unscaled. A scenario is terminated or truncated as its task defines;
    `info` then holds its metrics. Gymnasium's TimeLimit can truncate it earlier. Raises InputError
    for an action that is not in the table.

    It is a `skystack.gym.stacked.TwoPhaseEnvironment`: instead of `step`, call `instruct` any
    number of times, then `advance`. `render_mode="rgb_array"` draws a radar picture. Environments
    of one task can share its compiled `programs`.

    It can be copied and pickled at any time; the copy continues identically. Creating it does not
    start JAX. Raises InputError in a process that was forked after JAX was started.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": FRAMES_PER_S}  # noqa: RUF012

    def __init__(
        self, task: Task, render_mode: str | None = None, programs: PlainTask | None = None
    ) -> None:
        self.task, self.render_mode = task, render_mode
        self.observation_space, self.action_space = observations_of(task), actions_of(task)
        self._radar = radar_of(task, render_mode)
        self._programs = PlainTask(task) if programs is None else programs
        self._state: PlainState | None = None

    @property
    def programs(self) -> PlainTask:
        """The compiled programs of the task."""
        return self._programs

    @property
    def task_state(self) -> TaskState:
        """The state of the scenario in the task. Raises ResetNeeded before the first reset."""
        return self._programs.state_of(self._scenario)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Start a new random scenario. A seed determines it and all scenarios that follow."""
        super().reset(seed=seed, options=options)
        self._state = self._programs.reset(next_key(self.np_random))
        if self._radar is not None:
            self._radar.clear()
            self._radar.sweep(self.task_state)
        return self.observe(), {}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, Info]:
        """The task's step: issue an instruction, or none (action 0), and fly one radar cycle.

        With `timing = "stack"`, a step that continues a stack flies no cycle.
        """
        result = self._finish_cycle(*self._programs.step(self._scenario, action))
        return self.observe(), *result

    def observe(self) -> Observation:
        """A copy of the current observation."""
        leaves = jax.tree.leaves(self._programs.observe(self._scenario))
        return np.concatenate([np.ravel(leaf) for leaf in leaves])

    def may_stack(self, action: Any) -> bool:
        """Whether the instruction can be issued now."""
        return self._programs.may_stack(self._scenario, action)

    def instruct(self, action: Any) -> None:
        """Issue an instruction; no time passes."""
        self._state = self._programs.instruct(self._scenario, action)

    def advance(self) -> tuple[float, bool, bool, Info]:
        """Fly one radar cycle: (reward, terminated, truncated, info)."""
        return self._finish_cycle(*self._programs.advance(self._scenario))

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:
        """The current radar picture; None without a render mode."""
        return None if self._radar is None else self._radar.picture(self.task_state)

    @property
    def _scenario(self) -> PlainState:
        return started(self._state)

    def _finish_cycle(self, state: PlainState, outcome: Outcome) -> tuple[float, bool, bool, Info]:
        self._state = state
        if self._radar is not None:
            self._radar.sweep(self.task_state)
        terminated = bool(outcome.terminated.all())
        truncated = bool(outcome.ended) and not terminated
        info = metrics_info(outcome.metrics) if outcome.ended else {}
        return float(outcome.reward.sum()), terminated, truncated, info


def started(state: Started | None) -> Started:
    """The state of a scenario. Raises ResetNeeded before the first reset.

    Raises InputError in a process that was forked after JAX was started.
    """
    refuse_forked()
    if state is None:
        raise ResetNeeded("no scenario has been started (call reset first)")
    return state


def observations_of(task: Task) -> spaces.Box:
    """The observation space of a task; observations are flattened."""
    return spaces.Box(0.0, 1.0, (len(task.observation_names),), np.float32)


def actions_of(task: Task) -> spaces.Discrete:
    """The action space of a task."""
    return spaces.Discrete(len(task.action_names))


def radar_of(task: Task, render_mode: str | None) -> Radar | None:
    """The radar of a task; None without a render mode. Raises InputError for an unknown mode."""
    if render_mode is None:
        return None
    if render_mode not in RENDER_MODES:
        raise InputError(f"render_mode is {render_mode} (allowed: {', '.join(RENDER_MODES)})")
    return Radar(task)


def next_key(generator: np.random.Generator) -> PRNGKeyArray:
    """The random key of the next scenario. Raises InputError as `refuse_forked` does."""
    refuse_forked()
    return jax.random.key(next_seed(generator))


def next_seed(generator: np.random.Generator) -> int:
    """The seed of the next scenario's key."""
    return int(generator.integers(2**31))


def metrics_info(metrics: Mapping[str, Any]) -> Info:
    """The metrics of one scenario as plain numbers."""
    return {name: np.asarray(value).item() for name, value in metrics.items()}
