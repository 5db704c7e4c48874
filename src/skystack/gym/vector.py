"""Many scenarios of a task as one Gymnasium vector environment, in one compiled program."""

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
from skystack.compilation.packing import Packed, packed
from skystack.errors import InputError, checked_integer
from skystack.gym.environment import (
    FRAMES_PER_S,
    RENDER_MODES,
    actions_of,
    metrics_info,
    next_seed,
    observations_of,
    radar_of,
)
from skystack.gym.radar import Radar
from skystack.tasks.batch import choose, reset_each
from skystack.tasks.contract import Outcome, Task, TaskState
from skystack.tasks.observations import flatten_observation
from skystack.tasks.plain import checked_actions
from skystack.tasks.programs import TaskPrograms, compiled

Observations = Float[np.ndarray, "scenarios observation"]
Flags = Bool[np.ndarray, " scenarios"]
Rewards = Float[np.ndarray, " scenarios"]
Infos = dict[str, Any]

Picture = UInt8[np.ndarray, "height width 3"]


class VectorTaskEnvironment(VectorEnv[Observations, Int[np.ndarray, " scenarios"], np.ndarray]):
    """Equivalent to `gymnasium.vector.SyncVectorEnv` of single environments, in one program.

    The task must accept batches (`skystack.tasks.batch` can make it). Scenario i of `reset(seed=s)`
    and those that follow it are the single environment's under seed s + i. A scenario that has
    ended restarts as `autoreset_mode` says: NEXT_STEP in the next step, SAME_STEP in the same one
    (`infos` then holds `final_obs` and `final_info`), DISABLED only by `reset` with a `reset_mask`.
    After `max_episode_steps` steps a scenario is truncated, as by Gymnasium's TimeLimit.
    `render_mode="rgb_array"` draws a radar picture of each scenario. Environments of one task can
    share its compiled `programs`.

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
        programs: "VectorPrograms | None" = None,
    ) -> None:
        num_envs = checked_integer("num_envs", num_envs, 1)
        if max_episode_steps is not None:
            max_episode_steps = checked_integer("max_episode_steps", max_episode_steps, 1)
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
        self._step_limit = np.inf if max_episode_steps is None else max_episode_steps
        self._generators = [seeding.np_random() for _ in range(num_envs)]
        self._programs = VectorPrograms(task) if programs is None else programs
        self._radars = _radars_of(task, render_mode, num_envs)
        self._state: Packed | None = None
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._ended = np.zeros(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, Infos]:
        """Start new scenarios. `seed` is a list, or one number s: scenario i then has seed s + i.

        `options={"reset_mask": mask}`, a boolean array with one value per scenario, restarts only
        those where it is true. The seeds of the others are ignored and their observations stay the
        same. Raises InputError for an invalid seed or mask.
        """
        refuse_forked()
        restarts, seeds = self._checked_mask(options), self._seeds(seed)
        if self._state is None and not restarts.all():
            raise ResetNeeded("the first reset must start all scenarios")
        for number in np.flatnonzero(restarts).tolist():
            own = seeds[number]
            if own is not None:
                self._generators[number] = seeding.np_random(own)
        observation = self._restart(restarts)
        self._ended[restarts] = False
        self._sweep(restarts)
        return observation, {}

    def step(self, actions: Any) -> tuple[Observations, Rewards, Flags, Flags, Infos]:
        """One step of every scenario; ended ones restart according to the autoreset mode.

        Raises InputError unless `actions` holds one whole number from the action table for each
        scenario, and ResetNeeded if a scenario has ended and the mode is DISABLED.
        """
        self._check_ready()
        chosen = checked_actions(actions, self.num_envs, len(self.task.action_names))
        self._state, seen = self._programs.step(self._state, chosen)
        observation, outcome = seen.fetched()
        observation = np.ascontiguousarray(observation.T)
        # In NEXT_STEP mode the step after the end only restarts a scenario.
        restarting = self._ended & (self._mode is AutoresetMode.NEXT_STEP)
        self._steps += 1
        all_terminated = outcome.terminated.all(axis=0)
        cut_off = (outcome.ended & ~all_terminated) | (self._steps >= self._step_limit)
        terminated, truncated = all_terminated & ~restarting, cut_off & ~restarting
        self._ended = np.asarray(terminated | truncated)
        infos = self._infos(observation, outcome)
        restarts = self._ended if self._mode is AutoresetMode.SAME_STEP else restarting
        if restarts.any():
            observation = self._restart(restarts)
        self._sweep(restarts)
        rewards = np.where(restarting, 0.0, outcome.reward.sum(axis=0)).astype(np.float64)
        return observation, rewards, np.asarray(terminated), np.asarray(truncated), infos

    def render(self) -> tuple[Picture, ...] | None:
        """The radar picture of each scenario; None without a render mode."""
        if not self._radars:
            return None
        self._check_started()
        pairs = zip(self._radars, self._states(), strict=True)
        return tuple(radar.picture(state) for radar, state in pairs)

    @property
    def programs(self) -> "VectorPrograms":
        """The compiled programs of the task."""
        return self._programs

    @property
    def max_episode_steps(self) -> int | None:
        """The number of steps after which a scenario is truncated; None: no limit."""
        return None if self._step_limit == np.inf else int(self._step_limit)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of each scenario's generator."""
        return tuple(seed for _, seed in self._generators)

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generator that draws the successors of each scenario."""
        return tuple(generator for generator, _ in self._generators)

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

    def _key_seeds(self, restarts: Flags) -> UInt32[np.ndarray, " scenarios"]:
        """The seeds of the keys of new scenarios; 0 for those that continue."""
        pairs = zip(self.np_random, restarts, strict=True)
        return np.array([next_seed(own) if new else 0 for own, new in pairs], dtype=np.uint32)

    def _infos(self, observation: Observations, outcome: Outcome) -> Infos:
        """Infos as SyncVectorEnv gathers them; metrics only of scenarios that their task ended."""
        infos: Infos = {}
        for number in np.flatnonzero(self._ended).tolist():
            own = {name: values[number] for name, values in outcome.metrics.items()}
            info = metrics_info(own) if outcome.ended[number] else {}
            if self._mode is AutoresetMode.SAME_STEP:
                info = {"final_obs": observation[number], "final_info": info}
            infos = self._add_info(infos, info, number)
        return infos

    def _check_started(self) -> None:
        refuse_forked()
        if self._state is None:
            raise ResetNeeded("no scenarios have been started (call reset first)")

    def _check_ready(self) -> None:
        self._check_started()
        if self._mode is AutoresetMode.DISABLED and self._ended.any():
            raise ResetNeeded(
                f"scenarios {np.flatnonzero(self._ended).tolist()} have ended (with autoreset_mode "
                'Disabled, restart them by reset(options={"reset_mask": mask}))'
            )

    def _checked_mask(self, options: dict[str, Any] | None) -> Flags:
        """A mask of the scenarios to restart."""
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

    def _restart(self, restarts: Flags) -> Observations:
        """Restart the scenarios of the mask; returns the observations of all scenarios."""
        seeds = self._key_seeds(restarts)
        if restarts.all():
            self._state, seen = self._programs.begin(seeds)
        else:
            self._state, seen = self._programs.restart(self._state, restarts, seeds)
        self._steps[restarts] = 0
        return np.ascontiguousarray(seen.fetched()[0].T)

    def _sweep(self, restarts: Flags) -> None:
        """Add a radar position to the trail of each scenario; restarted ones get a new trail."""
        if not self._radars:
            return
        for radar, new, state in zip(self._radars, restarts, self._states(), strict=True):
            if new:
                radar.clear()
            radar.sweep(state)

    def _states(self) -> Iterator[TaskState]:
        """The state of each scenario, in numpy arrays."""
        assert self._state is not None
        states = self._state.fetched()
        for number in range(self.num_envs):
            yield jax.tree.map(lambda values, number=number: values[..., number], states)


class VectorPrograms(TaskPrograms):
    """The environment's compiled programs. States, and what is seen of them, are packed."""

    @compiled
    def begin(self, seeds: UInt32[Array, " scenarios"]) -> tuple[Packed, Packed]:
        """New scenarios, one per seed of a key: their state and observation."""
        return self._seen(self._reset(seeds))

    @compiled
    def step(self, state: Packed, actions: Int[Array, " scenarios"]) -> tuple[Packed, Packed]:
        """The MDP step of every scenario: the state, and its observation and outcome."""
        return self._seen(*self._task.step(state.unpacked(), actions))

    @compiled
    def restart(
        self,
        state: Packed,
        restarts: Bool[Array, " scenarios"],
        seeds: UInt32[Array, " scenarios"],
    ) -> tuple[Packed, Packed]:
        """New scenarios where `restarts` is true; the others continue. Returns as `begin` does."""
        return self._seen(choose(restarts, self._reset(seeds), state.unpacked()))

    def _reset(self, seeds: UInt32[Array, " scenarios"]) -> TaskState:
        return reset_each(self._task, jax.vmap(jax.random.key)(seeds))

    def _seen(self, state: TaskState, *outcome: Outcome) -> tuple[Packed, Packed]:
        observation = flatten_observation(self._task.observe(state), batch_axes=1)
        return packed(state, batch_axes=1), packed((observation, *outcome), batch_axes=1)


def _radars_of(task: Task, render_mode: str | None, scenarios: int) -> list[Radar]:
    """One radar per scenario; none without a render mode."""
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
