"""Sector control with one agent per flight, for PettingZoo (extra `[pettingzoo]`)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from jaxtyping import Int

from skystack.errors import requires_extra, unknown_name
from skystack.gym.environment import actions_of, metrics_info, observations_of, started
from skystack.gym.sector import RunningSector, SectorPrograms, sector_task
from skystack.io.files import AnyPath
from skystack.simulator.arrivals import FREE, MOST_DUE
from skystack.simulator.traffic import callsigns
from skystack.stacking import NO_OP
from skystack.tasks.plain import checked_action
from skystack.tasks.sector_control import SectorControl
from skystack.tasks.settings import TaskSettings

with requires_extra(__name__, "pettingzoo"):
    from pettingzoo import ParallelEnv

Observed = dict[str, np.ndarray]
Infos = dict[str, dict[str, Any]]


class FlightsEnvironment(RunningSector, ParallelEnv):  # type: ignore[misc]
    """Sector control with one agent per flight: AC1, AC2, ... in order of arrival.

    `agents` are the flights that hear the controller. In each cycle, an agent takes one action of
    the task's table; an agent missing from `actions` takes action 0, none. Each gets its own reward
    and is terminated when it leaves. At the end of the scenario, the others are truncated, and all
    infos hold the scenario's metrics. The last observation of a flight that has left is zero.
    `action_mask` in the infos marks action 0 and the actions that change something.

    It can be copied and pickled at any time; the copy continues identically.
    """

    metadata = {"name": "skystack-sector", "render_modes": []}  # noqa: RUF012

    def __init__(self, task: SectorControl, programs: SectorPrograms | None = None) -> None:
        super().__init__(task, programs)
        self.render_mode = None
        # The number of flights in a scenario is random. This is an upper bound.
        self.possible_agents = callsigns(task.cycles * MOST_DUE)
        self.agents: list[str] = []
        self._spaces: dict[str, tuple[spaces.Box, spaces.Discrete]] = {}

    def observation_space(self, agent: str) -> spaces.Box:
        return self._spaces_of(agent)[0]

    def action_space(self, agent: str) -> spaces.Discrete:
        return self._spaces_of(agent)[1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, Infos]:
        """Start a new random scenario. The sector may be empty at first."""
        self._start(seed)
        self.agents = [self._name(flight) for flight in self._flights()]
        return self._observations(self.agents), self._infos(self.agents)

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Observed, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Instruct the flights, then fly one cycle.

        Raises InputError for an unknown agent or action. Actions of flights that are not in the
        sector, or do not hear the controller yet, are ignored.
        """
        started(self._state)  # raises before the first reset
        chosen, slots = self._task_actions(actions), self._flights()
        outcome = self._fly(chosen)
        before, ended = self.agents, bool(outcome.ended)
        born = [self._name(each) for each in self._flights() if each not in slots]
        rewards = {self._name(each): float(outcome.reward[at]) for each, at in slots.items()}
        left = {self._name(each): bool(outcome.terminated[at]) for each, at in slots.items()}
        stays = [agent for agent in before if not left[agent]]
        shown = before if ended else [*before, *born]
        infos = self._infos(shown)
        if ended:
            for info in infos.values():
                info.update(metrics_info(outcome.metrics))
        self.agents = [] if ended else [*stays, *born]
        return (
            self._observations(shown),
            {agent: rewards.get(agent, 0.0) for agent in shown},
            {agent: left.get(agent, False) for agent in shown},
            {agent: ended and not left.get(agent, False) for agent in shown},
            infos,
        )

    def _name(self, flight: int) -> str:
        return self.possible_agents[flight]

    def _spaces_of(self, agent: str) -> tuple[spaces.Box, spaces.Discrete]:
        if agent not in self._spaces:
            self._spaces[agent] = (observations_of(self.task), actions_of(self.task))
        return self._spaces[agent]

    def _flights(self) -> dict[int, int]:
        """The slot of each flight that decides."""
        numbers = self._view.flight
        slots = np.flatnonzero(numbers != FREE)
        return dict(sorted(zip(numbers[slots].tolist(), slots.tolist(), strict=True)))

    def _slots(self) -> dict[str, int]:
        return {self._name(flight): slot for flight, slot in self._flights().items()}

    def _observations(self, agents: list[str]) -> Observed:
        slots = self._slots()
        nothing = np.zeros(len(self.task.observation_names), dtype=np.float32)
        return {
            agent: np.array(self._view.observation[slots[agent]] if agent in slots else nothing)
            for agent in agents
        }

    def _infos(self, agents: list[str]) -> Infos:
        slots = self._slots()
        only_none = np.arange(len(self.task.action_names)) == NO_OP
        return {
            agent: {
                "action_mask": np.asarray(
                    self._view.allowed[slots[agent]] if agent in slots else only_none, np.int8
                )
            }
            for agent in agents
        }

    def _task_actions(self, actions: Mapping[str, Any]) -> Int[np.ndarray, " slots"]:
        chosen = np.full(self.task.agents, NO_OP, dtype=np.int32)
        slots, last = self._slots(), len(self.task.action_names)
        for agent, action in actions.items():
            number = checked_action(action, last)
            if agent in slots:
                chosen[slots[agent]] = number
            elif agent not in self.possible_agents:
                raise unknown_name("agent", str(agent), self.agents)
        return chosen


def flights_env(
    experiment: AnyPath = SectorControl.name, settings: TaskSettings | None = None
) -> FlightsEnvironment:
    """The environment of an experiment (a name or a `.toml` file) or of settings.

    Raises InputError for an unknown experiment, and for one that is not sector control.
    """
    return FlightsEnvironment(sector_task(experiment, settings))
