"""One scenario as a Gymnasium environment, stepped through, or in its two phases."""

from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from jaxtyping import Float, PRNGKeyArray, UInt8

from skystack.compilation.forks import refuse_forked
from skystack.errors import InputError
from skystack.gym.radar import Radar
from skystack.tasks.contract import Metrics, Outcome, Task
from skystack.tasks.plain import PlainState, PlainTask

Observation = Float[np.ndarray, " observation"]
Info = dict[str, Any]

RENDER_MODES = ("rgb_array",)
FRAMES_PER_S = 10


class TaskEnvironment(gymnasium.Env[Observation, np.int64]):
    """Any task, for learners that know Gymnasium.

    Observations are float32 in [0, 1], actions numbers into the task's action table, rewards as the
    task pays them, unscaled. When a scenario has ended, `info` holds its metrics. Tasks end by
    themselves (terminated) and never truncate; Gymnasium's TimeLimit does. Raises InputError for
    an action that is not in the table.

    It is a `skystack.gym.stacked.TwoPhaseEnvironment`: `instruct` as often as wanted, then
    `advance`, instead of `step`. `render_mode="rgb_array"` draws a radar picture. Environments of
    one task can share its compiled `programs`.

    It can be copied and pickled at any time; the copy continues identically. Making it does not
    start JAX. Raises InputError in a process that was forked after JAX was started.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": FRAMES_PER_S}  # noqa: RUF012

    def __init__(
        self, task: Task, render_mode: str | None = None, programs: PlainTask | None = None
    ) -> None:
        self.task, self.render_mode = task, render_mode
        self.observation_space, self.action_space = observations_of(task), actions_of(task)
        self._radar = radar_of(task, render_mode)
        self._plain = PlainTask(task) if programs is None else programs
        self._now: PlainState | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """A new random scenario: after a seed always the same ones in the same order."""
        super().reset(seed=seed, options=options)
        self._now = self._plain.reset(drawn_key(self.np_random))
        if self._radar is not None:
            self._radar.clear()
            self._radar.sweep(self._plain.state_of(self._now))
        return self.observe(), {}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, Info]:
        """The task's step: give an instruction, or none, and fly one radar cycle."""
        flown = self._flown(*self._plain.step(self._scenario, action))
        return self.observe(), *flown

    def observe(self) -> Observation:
        """What is seen now; a copy."""
        return np.array(self._plain.observe(self._scenario))

    def may_stack(self, action: Any) -> bool:
        """Whether an instruction can be given now."""
        return self._plain.may_stack(self._scenario, action)

    def instruct(self, action: Any) -> None:
        """Give an instruction; no time passes."""
        self._now = self._plain.instruct(self._scenario, action)

    def advance(self) -> tuple[float, bool, bool, Info]:
        """Fly one radar cycle: (reward, terminated, truncated, info)."""
        return self._flown(*self._plain.advance(self._scenario))

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:
        """The radar picture of now; None without a render mode."""
        if self._radar is None:
            return None
        return self._radar.picture(self._plain.state_of(self._scenario))

    @property
    def _scenario(self) -> PlainState:
        refuse_forked()
        if self._now is None:
            raise ResetNeeded("reset() begins the first scenario")
        return self._now

    def _flown(self, now: PlainState, outcome: Outcome) -> tuple[float, bool, bool, Info]:
        self._now = now
        if self._radar is not None:
            self._radar.sweep(self._plain.state_of(now))
        judged: Outcome = jax.device_get(outcome)
        ended = bool(judged.terminated), bool(judged.truncated)
        return float(judged.reward), *ended, metrics_info(judged.metrics) if any(ended) else {}


def observations_of(task: Task) -> spaces.Box:
    """The space of a task's observations."""
    return spaces.Box(0.0, 1.0, (len(task.observation_names),), np.float32)


def actions_of(task: Task) -> spaces.Discrete:
    """The space of a task's actions."""
    return spaces.Discrete(len(task.action_names))


def radar_of(task: Task, render_mode: str | None) -> Radar | None:
    """What draws a task in a render mode, if any. Raises InputError for an unknown mode."""
    if render_mode is None:
        return None
    if render_mode not in RENDER_MODES:
        raise InputError(f"render_mode is {render_mode} (allowed: {', '.join(RENDER_MODES)})")
    return Radar(task)


def drawn_key(generator: np.random.Generator) -> PRNGKeyArray:
    """The key of the next scenario. Raises InputError as `refuse_forked`."""
    refuse_forked()
    return jax.random.key(drawn_number(generator))


def drawn_number(generator: np.random.Generator) -> int:
    """What the key of the next scenario is made from."""
    return int(generator.integers(2**31))


def metrics_info(metrics: Metrics) -> Info:
    """The metrics of one scenario as plain numbers."""
    return {name: np.asarray(value).item() for name, value in metrics._asdict().items()}
