"""Many scenarios of a task as one Gymnasium vector environment, computed by one program."""

from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Array, Bool, Float, Int, UInt8, UInt32

from skystack.compilation.forks import refuse_forked
from skystack.errors import InputError, checked_whole
from skystack.gym.environment import (
    FRAMES_PER_S,
    RENDER_MODES,
    actions_of,
    drawn_number,
    metrics_info,
    observations_of,
    radar_of,
)
from skystack.gym.radar import Radar
from skystack.tasks.batch import choose
from skystack.tasks.contract import Outcome, Task, TaskState
from skystack.tasks.programs import TaskPrograms, compiled

Observations = Float[np.ndarray, "scenarios observation"]
Flags = Bool[np.ndarray, " scenarios"]
Rewards = Float[np.ndarray, " scenarios"]
Infos = dict[str, Any]

Picture = UInt8[np.ndarray, "height width 3"]


class VectorTaskEnvironment(VectorEnv[Observations, Int[np.ndarray, " scenarios"], np.ndarray]):
    """What `gymnasium.vector.SyncVectorEnv` of single environments does, in one program.

    The task must take a batch (see `skystack.tasks.batch`, also for one that does not). Scenario i
    of `reset(seed=s)` is that of the single environment under seed s + i, and so are those that
    follow. `autoreset_mode` is NEXT_STEP (the step after the end begins anew), SAME_STEP (the
    ending step does; `infos` holds `final_obs` and `final_info`), or DISABLED (`reset` with a
    `reset_mask` does). After `max_episode_steps` steps a scenario is truncated, as by Gymnasium's
    TimeLimit. `render_mode="rgb_array"` draws a radar picture of each scenario.

    It can be copied and pickled at any time; the copy continues identically. Raises InputError in a
    process that was forked after JAX was started.
    """

    def __init__(
        self,
        task: Task,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        num_envs = checked_whole("num_envs", num_envs, 1)
        if max_episode_steps is not None:
            max_episode_steps = checked_whole("max_episode_steps", max_episode_steps, 1)
        self.task, self.num_envs, self._mode = task, num_envs, _checked_mode(autoreset_mode)
        self.render_mode = render_mode
        self.metadata = {
            "autoreset_mode": self._mode,
            "render_modes": list(RENDER_MODES),
            "render_fps": FRAMES_PER_S,
        }
        self.single_observation_space, self.single_action_space = (
            observations_of(task),
            actions_of(task),
        )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._most_steps = np.inf if max_episode_steps is None else max_episode_steps
        self._seeded = [seeding.np_random() for _ in range(num_envs)]
        self._programs = VectorPrograms(task)
        self._radars = _radars_of(task, render_mode, num_envs)
        self._state: TaskState = None
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._over = np.zeros(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, Infos]:
        """New scenarios; `seed` is that of the first, the next one's one more, or a list.

        `options={"reset_mask": mask}`, a boolean array with a value for each scenario, restarts
        only those where it is true. The seeds of the others are ignored, and their observations
        are the ones that they had. Raises InputError for a seed or mask of another kind.
        """
        refuse_forked()
        anew, seeds = self._checked_mask(options), self._seeds(seed)
        if self._state is None and not anew.all():
            raise ResetNeeded("a reset of all scenarios comes before that of some")
        for number in np.flatnonzero(anew).tolist():
            own = seeds[number]
            if own is not None:
                self._seeded[number] = seeding.np_random(own)
        observation = self._restart(anew)
        self._over[anew] = False
        self._sweep(anew)
        return np.array(observation), {}

    def step(self, actions: Any) -> tuple[Observations, Rewards, Flags, Flags, Infos]:
        """One step of every scenario; those that are over begin anew, as the mode says.

        Raises InputError unless `actions` is one whole number for each, from the action table, and
        ResetNeeded if a scenario is over and the mode is DISABLED.
        """
        self._check_ready()
        self._state, observation, outcome = self._programs.step(self._state, self._checked(actions))
        judged: Outcome = jax.device_get(outcome)
        resting = self._over & (self._mode is AutoresetMode.NEXT_STEP)
        self._steps += 1
        terminated = judged.terminated & ~resting
        truncated = (judged.truncated | (self._steps >= self._most_steps)) & ~resting
        self._over = np.asarray(terminated | truncated)
        infos = self._infos(np.array(observation), judged)
        anew = self._over if self._mode is AutoresetMode.SAME_STEP else resting
        if anew.any():
            observation = self._restart(anew)
        self._sweep(anew)
        rewards = np.where(resting, 0.0, judged.reward).astype(np.float64)
        return np.array(observation), rewards, np.asarray(terminated), np.asarray(truncated), infos

    def render(self) -> tuple[Picture, ...] | None:
        """The radar picture of each scenario; None without a render mode."""
        if not self._radars:
            return None
        self._check_begun()
        each = zip(self._radars, self._each_state(), strict=True)
        return tuple(radar.picture(state) for radar, state in each)

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
        try:
            count = len(seed)
        except TypeError:
            raise InputError(
                f"seed is {seed!r} (allowed: a whole number, or a list of them)"
            ) from None
        if count != self.num_envs:
            raise InputError(f"seed is a list of {count} (allowed: {self.num_envs})")
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

    def _check_begun(self) -> None:
        refuse_forked()
        if self._state is None:
            raise ResetNeeded("reset() begins the first scenarios")

    def _check_ready(self) -> None:
        self._check_begun()
        if self._mode is AutoresetMode.DISABLED and self._over.any():
            raise ResetNeeded(
                f"scenarios {np.flatnonzero(self._over).tolist()} are over (with autoreset_mode "
                'Disabled, reset(options={"reset_mask": mask}) restarts them)'
            )

    def _checked_mask(self, options: dict[str, Any] | None) -> Flags:
        """Which scenarios begin anew."""
        if options is None or "reset_mask" not in options:
            return np.ones(self.num_envs, dtype=bool)
        mask = options["reset_mask"]
        array = isinstance(mask, np.ndarray) and mask.dtype == np.bool_
        if not array or mask.shape != (self.num_envs,) or not mask.any():
            raise InputError(
                f"reset_mask is {mask!r} (allowed: a numpy array of {self.num_envs} booleans, at "
                "least one of them true)"
            )
        return mask

    def _restart(self, anew: Flags) -> Float[Array, "scenarios observation"]:
        """New scenarios where `anew`; the observations of all."""
        numbers = self._numbers(anew)
        if anew.all():
            self._state, observation = self._programs.begin(numbers)
        else:
            self._state, observation = self._programs.restart(self._state, anew, numbers)
        self._steps[anew] = 0
        return observation

    def _sweep(self, anew: Flags) -> None:
        """One more radar position of every scenario, the first one where it is new."""
        if not self._radars:
            return
        for radar, new, state in zip(self._radars, anew, self._each_state(), strict=True):
            if new:
                radar.clear()
            radar.sweep(state)

    def _each_state(self) -> Iterator[TaskState]:
        """The state of each scenario, in numpy arrays."""
        states = jax.device_get(self._state)
        for number in range(self.num_envs):
            yield jax.tree.map(lambda values, number=number: values[..., number], states)


class VectorPrograms(TaskPrograms):
    """What the environment computes."""

    @compiled
    def begin(
        self, numbers: UInt32[Array, " scenarios"]
    ) -> tuple[TaskState, Float[Array, "scenarios observation"]]:
        """The scenarios of the keys made from numbers."""
        return self._seen(self._drawn(numbers))

    @compiled
    def step(
        self, state: TaskState, actions: Int[Array, " scenarios"]
    ) -> tuple[TaskState, Float[Array, "scenarios observation"], Outcome]:
        """The MDP step of every scenario."""
        state, outcome = self._task.step(state, actions)
        return *self._seen(state), outcome

    @compiled
    def restart(
        self,
        state: TaskState,
        anew: Bool[Array, " scenarios"],
        numbers: UInt32[Array, " scenarios"],
    ) -> tuple[TaskState, Float[Array, "scenarios observation"]]:
        """New scenarios where `anew`; the others continue."""
        return self._seen(choose(anew, self._drawn(numbers), state))

    def _drawn(self, numbers: UInt32[Array, " scenarios"]) -> TaskState:
        return jax.vmap(self._task.reset, out_axes=-1)(jax.vmap(jax.random.key)(numbers))

    def _seen(self, state: TaskState) -> tuple[TaskState, Float[Array, "scenarios observation"]]:
        return state, self._task.observe(state).T


def _radars_of(task: Task, render_mode: str | None, scenarios: int) -> list[Radar]:
    """One radar for each scenario; none without a render mode."""
    first = radar_of(task, render_mode)
    if first is None:
        return []
    return [first, *(Radar(task, first.screen) for _ in range(scenarios - 1))]


def _checked_mode(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError:
        allowed = ", ".join(each.value for each in AutoresetMode)
        raise InputError(f"autoreset_mode is {mode} (allowed: {allowed})") from None
