"""One scenario as a Gymnasium environment: a step is `advance(instruct(state, action))`."""

from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium import spaces
from jaxtyping import Array, Float

from skystack.tasks.contract import Outcome, Task, TaskState

Observation = Float[np.ndarray, " observation"]


class TaskEnvironment(gymnasium.Env[Observation, np.int64]):
    """Any task, for learners that know Gymnasium.

    Observations are float32 in [0, 1], actions numbers into the task's action table, rewards as the
    task pays them, unscaled. When a scenario has ended, `info` holds its metrics.
    """

    def __init__(self, task: Task) -> None:
        self.task = task
        self.observation_space = spaces.Box(0.0, 1.0, (len(task.observation_names),), np.float32)
        self.action_space = spaces.Discrete(len(task.action_names))
        self._reset, self._step = jax.jit(self._begin), jax.jit(self._go_on)
        self._state: TaskState = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """A new random scenario: after a seed always the same ones in the same order."""
        super().reset(seed=seed, options=options)
        key = jax.random.key(int(self.np_random.integers(2**31)))
        self._state, observation = self._reset(key)
        return np.asarray(observation), {}

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Give an instruction, or none, and fly one radar cycle."""
        self._state, observation, outcome = self._step(self._state, np.int32(action))
        judged: Outcome = jax.device_get(outcome)
        ended = bool(judged.terminated), bool(judged.truncated)
        metrics = judged.metrics._asdict() if any(ended) else {}
        info = {name: np.asarray(value).item() for name, value in metrics.items()}
        return np.asarray(observation), float(judged.reward), *ended, info

    def _begin(self, key: Array) -> tuple[TaskState, Array]:
        state = self.task.reset(key)
        return state, self.task.observe(state)

    def _go_on(self, state: TaskState, action: Array) -> tuple[TaskState, Array, Outcome]:
        state, outcome = self.task.step(state, action)
        return state, self.task.observe(state), outcome
