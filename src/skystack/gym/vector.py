"""Many scenarios of a task as one Gymnasium vector environment, computed by one program."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Array, Bool, Float, Int, UInt32

from skystack.errors import InputError
from skystack.gym.environment import actions_of, drawn_number, metrics_info, observations_of
from skystack.tasks.batch import choose
from skystack.tasks.contract import Outcome, Task, TaskState

Observations = Float[np.ndarray, "scenarios observation"]
Flags = Bool[np.ndarray, " scenarios"]
Rewards = Float[np.ndarray, " scenarios"]
Infos = dict[str, Any]

MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)


class VectorTaskEnvironment(VectorEnv[Observations, Int[np.ndarray, " scenarios"], np.ndarray]):
    """What `gymnasium.vector.SyncVectorEnv` of single environments does, in one program.

    The task must take a batch (see `skystack.tasks.batch`, also for one that does not). Scenario i
    of `reset(seed=s)` is that of the single environment under seed s + i, and so are those that
    follow. `autoreset_mode` is NEXT_STEP (the step after the end begins anew) or SAME_STEP (the
    ending step does; `infos` holds `final_obs` and `final_info`). After `max_episode_steps`
    steps a scenario is truncated, as by Gymnasium's TimeLimit.
    """

    def __init__(
        self,
        task: Task,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
    ) -> None:
        if num_envs < 1:
            raise InputError(f"num_envs is {num_envs} (allowed: 1 or more)")
        if max_episode_steps is not None and max_episode_steps < 1:
            raise InputError(f"max_episode_steps is {max_episode_steps} (allowed: 1 or more)")
        self.task, self.num_envs, self._mode = task, num_envs, _checked_mode(autoreset_mode)
        self.metadata = {"autoreset_mode": self._mode}
        self.single_observation_space, self.single_action_space = (
            observations_of(task),
            actions_of(task),
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._most_steps = np.inf if max_episode_steps is None else max_episode_steps
        self._seeded = [seeding.np_random() for _ in range(num_envs)]
        self._begun, self._stepped = jax.jit(self._begin), jax.jit(self._step)
        self._restarted = jax.jit(self._restart)
        self._state: TaskState = None
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._over = np.zeros(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, Infos]:
        """New scenarios for all; `seed` is that of the first, the next one's one more, or a list.

        Raises InputError for a list of another length.
        """
        for number, own in enumerate(self._seeds(seed)):
            if own is not None:
                self._seeded[number] = seeding.np_random(own)
        everywhere = np.ones(self.num_envs, dtype=bool)
        self._state, observation = self._begun(self._numbers(everywhere))
        self._steps[:], self._over[:] = 0, False
        return np.array(observation), {}

    def step(self, actions: Any) -> tuple[Observations, Rewards, Flags, Flags, Infos]:
        """One step of every scenario; those that are over begin anew, as the mode says.

        Raises InputError unless `actions` is one whole number for each, from the action table.
        """
        if self._state is None:
            raise ResetNeeded("reset() begins the first scenarios")
        self._state, observation, outcome = self._stepped(self._state, self._checked(actions))
        judged: Outcome = jax.device_get(outcome)
        resting = self._over & (self._mode is AutoresetMode.NEXT_STEP)
        self._steps += 1
        terminated = judged.terminated & ~resting
        truncated = (judged.truncated | (self._steps >= self._most_steps)) & ~resting
        self._over = np.asarray(terminated | truncated)
        infos = self._infos(np.array(observation), judged)
        anew = self._over if self._mode is AutoresetMode.SAME_STEP else resting
        if anew.any():
            numbers = self._numbers(anew)
            self._state, observation = self._restarted(self._state, anew, numbers)
            self._steps[anew] = 0
        rewards = np.where(resting, 0.0, judged.reward).astype(np.float64)
        return np.array(observation), rewards, np.asarray(terminated), np.asarray(truncated), infos

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of each scenario's generator."""
        return tuple(seed for _, seed in self._seeded)

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """What each scenario's successors are drawn by."""
        return tuple(generator for generator, _ in self._seeded)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [int(seed) + number for number in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise InputError(f"seed is a list of {len(seed)} (allowed: {self.num_envs})")
        return seed

    def _numbers(self, anew: Flags) -> UInt32[np.ndarray, " scenarios"]:
        """What the keys of new scenarios are made from; 0 for those that go on."""
        pairs = zip(self.np_random, anew, strict=True)
        return np.array([drawn_number(own) if new else 0 for own, new in pairs], dtype=np.uint32)

    def _checked(self, actions: Any) -> Int[np.ndarray, " scenarios"]:
        told = np.asarray(actions)
        most = len(self.task.action_names) - 1
        whole = told.shape == (self.num_envs,) and np.issubdtype(told.dtype, np.integer)
        if not whole or np.any((told < 0) | (told > most)):
            raise InputError(
                f"actions are {actions!r} (allowed: {self.num_envs} whole numbers from 0 to {most})"
            )
        return told.astype(np.int32)

    def _infos(self, observation: Observations, judged: Outcome) -> Infos:
        """As SyncVectorEnv gathers them: metrics of scenarios that have ended by themselves."""
        infos: Infos = {}
        for number in np.flatnonzero(self._over).tolist():
            own = jax.tree.map(lambda values, number=number: values[number], judged)
            info = metrics_info(own.metrics) if own.terminated or own.truncated else {}
            if self._mode is AutoresetMode.SAME_STEP:
                info = {"final_obs": observation[number], "final_info": info}
            infos = self._add_info(infos, info, number)
        return infos

    def _begin(self, numbers: UInt32[Array, " scenarios"]) -> tuple[TaskState, Array]:
        state = jax.vmap(self.task.reset, out_axes=-1)(jax.vmap(jax.random.key)(numbers))
        return state, self.task.observe(state).T

    def _step(
        self, state: TaskState, actions: Int[Array, " scenarios"]
    ) -> tuple[TaskState, Array, Outcome]:
        state, outcome = self.task.step(state, actions)
        return state, self.task.observe(state).T, outcome

    def _restart(
        self, state: TaskState, anew: Bool[Array, " scenarios"], numbers: Array
    ) -> tuple[TaskState, Array]:
        fresh, _ = self._begin(numbers)
        state = choose(anew, fresh, state)
        return state, self.task.observe(state).T


def _checked_mode(mode: AutoresetMode | str) -> AutoresetMode:
    allowed = [each.value for each in MODES]
    if mode not in (*MODES, *allowed):
        raise InputError(f"autoreset_mode is {mode} (allowed: {', '.join(allowed)})")
    return AutoresetMode(mode)
