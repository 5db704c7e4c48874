"""Sector control for learners that train one policy for all flights, as a vector environment."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Array, Bool, Int, PRNGKeyArray

from skystack.compilation.packing import Packed, packed
from skystack.errors import InputError
from skystack.gym.environment import actions_of, metrics_info, next_key, observations_of, started
from skystack.gym.registration import settings_of
from skystack.io.files import AnyPath
from skystack.simulator.arrivals import FREE
from skystack.tasks.contract import Outcome
from skystack.tasks.plain import checked_actions
from skystack.tasks.programs import TaskPrograms, compiled
from skystack.tasks.registry import build_task
from skystack.tasks.sector_control import ControlState, SectorControl
from skystack.tasks.settings import TaskSettings


class SectorView(NamedTuple):
    """What learners see of a sector, one row for each slot; arrays of numpy or JAX."""

    observation: Any
    """`[slots, observation]`."""
    flight: Any
    """The number of the flight that decides in each slot; FREE if there is none."""
    allowed: Any
    """`[slots, actions]`: which actions change something. Action 0, none, is always allowed."""

    @property
    def active(self) -> Bool[np.ndarray, " slots"]:
        """Whether there is a flight in each slot that decides."""
        decides: Bool[np.ndarray, " slots"] = np.not_equal(self.flight, FREE)
        return decides


class SectorPrograms(TaskPrograms):
    """The compiled programs of sector control for its environments."""

    _task: SectorControl

    @compiled
    def begin(self, key: PRNGKeyArray) -> tuple[Packed, Packed]:
        """The scenario of a key, and what is seen of it."""
        return self._seen(self._task.reset(key))

    @compiled
    def fly(self, state: Packed, action: Int[Array, " slots"]) -> tuple[Packed, Packed]:
        """Instruct all flights, then fly one cycle: the state, what is seen, and the outcome."""
        return self._seen(*self._task.step(state.unpacked(), action))

    def _seen(self, state: ControlState, *outcome: Outcome) -> tuple[Packed, Packed]:
        return packed(state), packed((self._view(state), *outcome))

    def _view(self, state: ControlState) -> SectorView:
        decides = self._task.active(state)
        flight = jnp.where(decides, state.world.arrivals.flight, FREE)
        observation = jnp.where(decides[:, None], self._task.observe(state).T, 0.0)
        return SectorView(observation, flight, self._task.allowed(state).T)


class RunningSector:
    """The scenario of an environment, and its task's programs, which environments can share."""

    def __init__(self, task: SectorControl, programs: SectorPrograms | None) -> None:
        self.task = task
        self.programs = SectorPrograms(task) if programs is None else programs
        self._generator: np.random.Generator | None = None
        self._state: Packed | None = None
        self._view: SectorView

    @property
    def task_state(self) -> ControlState:
        """The state of the scenario in the task. Raises ResetNeeded before the first reset."""
        state: ControlState = self.programs.unpacked(started(self._state))
        return state

    def _start(self, seed: int | None) -> None:
        """Begin a new random scenario. A seed determines it and all that follow."""
        if seed is not None or self._generator is None:
            self._generator, _ = seeding.np_random(seed)
        self._state, seen = self.programs.begin(next_key(self._generator))
        (self._view,) = seen.fetched()

    def _fly(self, actions: Int[np.ndarray, " slots"]) -> Any:
        """Instruct the flights, then fly one cycle; returns its `Outcome` in numpy."""
        self._state, seen = self.programs.fly(started(self._state), jnp.asarray(actions))
        self._view, outcome = seen.fetched()
        return outcome


class SectorVectorEnvironment(RunningSector, VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Sector control with one sub-environment for each slot of the sector.

    Flights use a slot one after another. `infos` describes the next step: `active` says whether
    each slot has a flight that decides, and `action_mask`, `[slots, actions]`, which actions change
    something. Where `active` is false, observations are zero and actions are ignored; do not learn
    from that step. A flight that leaves is terminated; the next one may enter its slot at any later
    step, without a reset. At the end of the scenario, all other slots are truncated. The next step
    only begins a new scenario, as in Gymnasium's mode NEXT_STEP; all other steps fly one cycle.

    Raises InputError for actions that are not in the table.
    """

    def __init__(self, task: SectorControl, programs: SectorPrograms | None = None) -> None:
        super().__init__(task, programs)
        self.num_envs = task.agents
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}
        self.single_observation_space = observations_of(task)
        self.single_action_space = actions_of(task)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._ended = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start a new random scenario. A seed determines it and all scenarios that follow."""
        self._start(seed)
        self._ended = False
        return self._view.observation, self._infos()

    def step(
        self, actions: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Instruct all flights, then fly one cycle; or begin a new scenario after the end."""
        chosen = checked_actions(actions, self.num_envs, len(self.task.action_names))
        if self._ended:
            observation, infos = self.reset()
            nothing = np.zeros(self.num_envs, dtype=bool)
            return observation, nothing.astype(np.float64), nothing, nothing.copy(), infos
        outcome = self._fly(chosen)
        self._ended = bool(outcome.ended)
        infos = self._infos()
        if self._ended:
            infos["metrics"] = metrics_info(outcome.metrics)
        reward = outcome.reward.astype(np.float64)
        return self._view.observation, reward, outcome.terminated, outcome.truncated, infos

    def _infos(self) -> dict[str, Any]:
        return {"active": self._view.active, "action_mask": self._view.allowed}


def sector_task(experiment: AnyPath, settings: TaskSettings | None = None) -> SectorControl:
    """The task of an experiment (a name or a `.toml` file) or of settings.

    Raises InputError if it is not sector control.
    """
    task = build_task(settings_of(experiment, settings))
    if not isinstance(task, SectorControl):
        raise InputError(f"task {task.name} is not for sectors (allowed: {SectorControl.name})")
    return task


def make_sector_environment(
    experiment: AnyPath = SectorControl.name, settings: TaskSettings | None = None
) -> SectorVectorEnvironment:
    """The vector environment of an experiment (a name or a `.toml` file) or of settings.

    Raises InputError for an unknown experiment, and for one that is not sector control.
    """
    return SectorVectorEnvironment(sector_task(experiment, settings))
