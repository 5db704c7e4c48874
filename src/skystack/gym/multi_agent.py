"""A task with each aircraft an agent of its own, for PettingZoo (extra `[pettingzoo]`)."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from jaxtyping import Array, Float, Int, PRNGKeyArray, UInt8

from skystack.compilation.forks import refuse_forked
from skystack.errors import of_extra, unknown_name
from skystack.gym.environment import (
    FRAMES_PER_S,
    RENDER_MODES,
    Observation,
    drawn_key,
    metrics_info,
    observations_of,
    radar_of,
)
from skystack.gym.registration import settings_of
from skystack.io.files import AnyPath
from skystack.simulator.traffic import callsigns
from skystack.tasks.build import build_task
from skystack.tasks.contract import NO_OP, Outcome
from skystack.tasks.navigation import NavigationState, NavigationTask
from skystack.tasks.plain import checked_action
from skystack.tasks.programs import TaskPrograms, compiled
from skystack.tasks.settings import TaskSettings

with of_extra(__name__, "pettingzoo"):
    from pettingzoo import ParallelEnv

Observed = dict[str, Observation]
Infos = dict[str, dict[str, Any]]


class MultiAgentEnvironment(ParallelEnv):  # type: ignore[misc]
    """A navigation task as a cooperative game of its aircraft: AC1, AC2, ...

    In each cycle every agent gives its own aircraft an instruction, or none (action 0); who is not
    in `actions` gives none. Then one cycle is flown. An agent sees what the task shows, with its
    own aircraft as the first and the others behind it in their order.

    All agents get the scenario's reward, and end together with the scenario, also those whose
    aircraft have left before: the terminal reward judges the scenario as a whole, and is theirs as
    well. Infos then hold the scenario's metrics. Instructions of several agents in one cycle are
    separate bursts, as nobody could say them in one breath.

    It can be copied and pickled at any time; the copy continues identically. Raises InputError in a
    process that was forked after JAX was started.
    """

    metadata = {  # noqa: RUF012
        "name": "skystack",
        "render_modes": list(RENDER_MODES),
        "render_fps": FRAMES_PER_S,
    }

    def __init__(self, task: NavigationTask, render_mode: str | None = None) -> None:
        self.task, self.render_mode = task, render_mode
        self.possible_agents = callsigns(task.scenarios.aircraft)
        self.agents: list[str] = []
        self._own_actions = [
            [NO_OP, *(n for n, (who, _) in enumerate(task.actions.changes, 1) if who == number)]
            for number in range(task.scenarios.aircraft)
        ]
        self._spaces = {
            agent: (observations_of(task), spaces.Discrete(len(own)))
            for agent, own in zip(self.possible_agents, self._own_actions, strict=True)
        }
        self._radar = radar_of(task, render_mode)
        self._generator: np.random.Generator | None = None
        self._programs = MultiAgentPrograms(task)
        self._now: NavigationState | None = None
        self._views: Float[Array, "aircraft observation"]

    def observation_space(self, agent: str) -> spaces.Box:
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> spaces.Discrete:
        return self._spaces[agent][1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, Infos]:
        """A new random scenario, that of the single environment under the same seed."""
        if seed is not None or self._generator is None:
            self._generator, _ = seeding.np_random(seed)
        self._now, self._views = self._programs.begin(drawn_key(self._generator))
        self.agents = self.possible_agents.copy()
        if self._radar is not None:
            self._radar.clear()
            self._radar.sweep(self._now)
        return self._observed(), {agent: {} for agent in self.agents}

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Observed, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """All instruct, then one cycle is flown.

        Raises InputError for an unknown agent or action.
        """
        self._now, self._views, outcome = self._programs.fly(self._scenario, self._told(actions))
        if self._radar is not None:
            self._radar.sweep(self._now)
        judged: Outcome = jax.device_get(outcome)
        terminated, truncated = bool(judged.terminated), bool(judged.truncated)
        info = metrics_info(judged.metrics) if terminated or truncated else {}
        result = (
            self._observed(),
            dict.fromkeys(self.agents, float(judged.reward)),
            dict.fromkeys(self.agents, terminated),
            dict.fromkeys(self.agents, truncated),
            {agent: info.copy() for agent in self.agents},
        )
        if terminated or truncated:
            self.agents = []
        return result

    def state(self) -> Observation:
        """The task's own observation: what one controller of all aircraft would see.

        Raises ResetNeeded before the first reset.
        """
        _ = self._scenario  # which raises
        return np.array(self._views[0])

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:
        """The radar picture of now; None without a render mode."""
        return None if self._radar is None else self._radar.picture(self._scenario)

    @property
    def _scenario(self) -> NavigationState:
        refuse_forked()
        if self._now is None:
            raise ResetNeeded("reset() begins the first scenario")
        return self._now

    def _observed(self) -> Observed:
        views = np.array(self._views)
        return {agent: views[self.possible_agents.index(agent)] for agent in self.agents}

    def _task_actions(self, actions: Mapping[str, Any]) -> Int[np.ndarray, " aircraft"]:
        """The task's action of each aircraft."""
        told = np.full(len(self.possible_agents), NO_OP, dtype=np.int32)
        for agent, action in actions.items():
            if agent not in self.possible_agents:
                raise unknown_name("agent", str(agent), self.possible_agents)
            number = self.possible_agents.index(agent)
            own = self._own_actions[number]
            told[number] = own[checked_action(action, len(own))]
        return told


class MultiAgentPrograms(TaskPrograms):
    """What the environment computes."""

    _task: NavigationTask

    @compiled
    def begin(
        self, key: PRNGKeyArray
    ) -> tuple[NavigationState, Float[Array, "aircraft observation"]]:
        """The scenario of a key, and what each aircraft sees."""
        state = self._task.reset(key)
        return state, self._view(state)

    @compiled
    def fly(
        self, state: NavigationState, actions: Int[Array, " aircraft"]
    ) -> tuple[NavigationState, Float[Array, "aircraft observation"], Outcome]:
        """Instruct every aircraft, then fly one cycle."""
        for number in range(self._task.scenarios.aircraft):
            state = self._task.instruct(state, actions[number])
        state, outcome = self._task.advance(state)
        return state, self._view(state), outcome

    def _view(self, state: NavigationState) -> Float[Array, "aircraft observation"]:
        """What each aircraft sees: the task's observation of itself as the first."""
        aircraft = list(range(self._task.scenarios.aircraft))
        orders = [[own, *(other for other in aircraft if other != own)] for own in aircraft]

        def seen(order: Int[Array, " aircraft"]) -> Float[Array, " observation"]:
            return self._task.observe(
                # What has no axis is of the scenario.
                jax.tree.map(lambda values: values[order] if values.ndim else values, state)
            )

        views: Float[Array, "aircraft observation"] = jax.vmap(seen)(jnp.asarray(orders))
        return views


def parallel_env(
    experiment: AnyPath = "lateral",
    settings: TaskSettings | None = None,
    render_mode: str | None = None,
) -> MultiAgentEnvironment:
    """The environment of an experiment's name or `.toml` file, or of settings.

    Raises InputError for what does not exist or cannot be.
    """
    return MultiAgentEnvironment(build_task(settings_of(experiment, settings)), render_mode)
