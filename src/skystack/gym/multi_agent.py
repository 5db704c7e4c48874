"""A task with one agent per aircraft, for PettingZoo (extra `[pettingzoo]`)."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt8

from skystack.compilation.packing import Packed, packed
from skystack.errors import requires_extra, unknown_name
from skystack.gym.environment import (
    FRAMES_PER_S,
    RENDER_MODES,
    Observation,
    metrics_info,
    next_key,
    observations_of,
    radar_of,
    started,
)
from skystack.gym.registration import settings_of
from skystack.io.files import AnyPath
from skystack.simulator.traffic import callsigns
from skystack.stacking import NO_OP
from skystack.tasks.contract import Outcome, TaskState, TrafficTask
from skystack.tasks.observations import flatten_observation
from skystack.tasks.plain import checked_action
from skystack.tasks.programs import TaskPrograms, compiled
from skystack.tasks.registry import build_traffic_task
from skystack.tasks.settings import TaskSettings

with requires_extra(__name__, "pettingzoo"):
    from pettingzoo import ParallelEnv

Observed = dict[str, Observation]
Infos = dict[str, dict[str, Any]]


class MultiAgentEnvironment(ParallelEnv):  # type: ignore[misc]
    """A traffic task as a cooperative game of its aircraft: AC1, AC2, ...

    In each cycle every agent issues one instruction to its own aircraft, or none (action 0); an
    agent that is not in `actions` issues none. Then one cycle is flown. An agent's observation is
    the task's, with its own aircraft first and the others after it in their usual order.

    All agents get the scenario's reward and end together with the scenario, including those whose
    aircraft left earlier: the terminal reward scores the scenario as a whole. Infos then hold the
    scenario's metrics. Instructions of several agents in one cycle are separate bursts, because one
    transmission addresses one aircraft. Environments of one task can share its compiled `programs`.

    It can be copied and pickled at any time; the copy continues identically. Raises InputError in a
    process that was forked after JAX was started.
    """

    metadata = {  # noqa: RUF012
        "name": "skystack",
        "render_modes": list(RENDER_MODES),
        "render_fps": FRAMES_PER_S,
    }

    def __init__(
        self,
        task: TrafficTask,
        render_mode: str | None = None,
        programs: "MultiAgentPrograms | None" = None,
    ) -> None:
        self.task, self.render_mode = task, render_mode
        self.possible_agents = callsigns(task.aircraft)
        self.agents: list[str] = []
        self._own_actions = [
            [NO_OP, *(n for n, action in enumerate(task.actions) if action.aircraft == number)]
            for number in range(task.aircraft)
        ]
        self._spaces = {
            agent: (observations_of(task), spaces.Discrete(len(own)))
            for agent, own in zip(self.possible_agents, self._own_actions, strict=True)
        }
        self._radar = radar_of(task, render_mode)
        self._generator: np.random.Generator | None = None
        self._programs = MultiAgentPrograms(task) if programs is None else programs
        self._state: Packed | None = None
        self._views: Float[np.ndarray, "aircraft observation"]

    @property
    def programs(self) -> "MultiAgentPrograms":
        """The compiled programs of the task."""
        return self._programs

    @property
    def task_state(self) -> TaskState:
        """The state of the scenario in the task. Raises ResetNeeded before the first reset."""
        return self._programs.unpacked(started(self._state))

    def observation_space(self, agent: str) -> spaces.Box:
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> spaces.Discrete:
        return self._spaces[agent][1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, Infos]:
        """Start a new random scenario: the same as TaskEnvironment's for the same seed."""
        if seed is not None or self._generator is None:
            self._generator, _ = seeding.np_random(seed)
        self._state, seen = self._programs.begin(next_key(self._generator))
        (self._views,) = seen.fetched()
        self.agents = self.possible_agents.copy()
        if self._radar is not None:
            self._radar.clear()
            self._radar.sweep(self.task_state)
        return self._observations(), {agent: {} for agent in self.agents}

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Observed, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Issue all instructions, then fly one cycle.

        Raises InputError for an unknown agent or action.
        """
        state = started(self._state)
        self._state, seen = self._programs.fly(state, self._task_actions(actions))
        self._views, outcome = seen.fetched()
        if self._radar is not None:
            self._radar.sweep(self.task_state)
        terminated = bool(outcome.terminated.all())
        truncated = bool(outcome.ended) and not terminated
        info = metrics_info(outcome.metrics) if terminated or truncated else {}
        result = (
            self._observations(),
            dict.fromkeys(self.agents, float(outcome.reward.sum())),
            dict.fromkeys(self.agents, terminated),
            dict.fromkeys(self.agents, truncated),
            {agent: info.copy() for agent in self.agents},
        )
        if terminated or truncated:
            self.agents = []
        return result

    def state(self) -> Observation:
        """The task's own observation, as a single controller of all aircraft would see it.

        Raises ResetNeeded before the first reset.
        """
        started(self._state)  # raises before the first reset
        return np.array(self._views[0])

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:
        """The current radar picture; None without a render mode."""
        return None if self._radar is None else self._radar.picture(self.task_state)

    def _observations(self) -> Observed:
        views = np.array(self._views)
        return {agent: views[self.possible_agents.index(agent)] for agent in self.agents}

    def _task_actions(self, actions: Mapping[str, Any]) -> Int[np.ndarray, " aircraft"]:
        """The task's action for each aircraft."""
        task_actions = np.full(len(self.possible_agents), NO_OP, dtype=np.int32)
        for agent, action in actions.items():
            if agent not in self.possible_agents:
                raise unknown_name("agent", str(agent), self.possible_agents)
            number = self.possible_agents.index(agent)
            own = self._own_actions[number]
            task_actions[number] = own[checked_action(action, len(own))]
        return task_actions


class MultiAgentPrograms(TaskPrograms):
    """The environment's compiled programs."""

    _task: TrafficTask

    @compiled
    def begin(self, key: PRNGKeyArray) -> tuple[Packed, Packed]:
        """The scenario of a key, and the observation of each agent."""
        return self._seen(self._task.reset(key))

    @compiled
    def fly(self, state: Packed, actions: Int[Array, " aircraft"]) -> tuple[Packed, Packed]:
        """Instruct every aircraft, then fly one cycle: the state, observations and outcome."""
        told = state.unpacked()
        for number in range(self._task.aircraft):
            told = self._task.instruct(told, actions[number])
        return self._seen(*self._task.advance(told))

    def _seen(self, state: TaskState, *outcome: Outcome) -> tuple[Packed, Packed]:
        return packed(state), packed((self._agent_views(state), *outcome))

    def _agent_views(self, state: TaskState) -> Float[Array, "aircraft observation"]:
        """The task's observation once per aircraft, with that aircraft first."""
        aircraft = list(range(self._task.aircraft))
        orders = [[own, *(other for other in aircraft if other != own)] for own in aircraft]

        def view(order: Int[Array, " aircraft"]) -> Float[Array, " observation"]:
            # Scalars belong to the whole scenario.
            own = jax.tree.map(lambda values: values[order] if values.ndim else values, state)
            return flatten_observation(self._task.observe(own))

        views: Float[Array, "aircraft observation"] = jax.vmap(view)(jnp.asarray(orders))
        return views


def parallel_env(
    experiment: AnyPath = "lateral",
    settings: TaskSettings | None = None,
    render_mode: str | None = None,
) -> MultiAgentEnvironment:
    """The environment of an experiment (a name or a `.toml` file) or of settings.

    Raises InputError for an unknown experiment and for invalid settings.
    """
    return MultiAgentEnvironment(build_traffic_task(settings_of(experiment, settings)), render_mode)
