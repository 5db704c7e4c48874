"""Traffic of one scenario, without arrivals: a scenario file, or an experiment's scenarios."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from skystack.errors import InputError
from skystack.learning.experiment import experiment_names, load_experiment
from skystack.simulator.arrivals import Clock
from skystack.simulator.drawn_flow import DrawnFlow
from skystack.simulator.generator import Drawn, Scenarios
from skystack.simulator.scenario_file import Scenario, load_scenario
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import ticks
from skystack.tasks.contract import TrafficTask
from skystack.tasks.registry import build_task
from skystack.tasks.sector_world import World

SCENARIO_SUFFIX, EXPERIMENT_SUFFIX = ".json", ".toml"
_MIN_SLOTS = 2
"""The minimum number of slots: outlooks compare each flight with another one."""


def is_scenario(traffic: str) -> bool:
    """Whether traffic names an experiment, an experiment file or a scenario file."""
    return traffic.endswith((SCENARIO_SUFFIX, EXPERIMENT_SUFFIX)) or traffic in _experiments()


@cache
def _experiments() -> frozenset[str]:
    return frozenset(experiment_names())


def is_scenario_file(traffic: str) -> bool:
    """Whether traffic is a scenario file, which is the same in every hour."""
    return traffic.endswith(SCENARIO_SUFFIX)


class ScenarioWorld(NamedTuple):
    """The world of a scenario."""

    world: World
    aircraft: int
    performance: str
    """The name of its performance model."""
    cycles: int
    """The length of the scenario in cycles."""


def scenario_world(traffic: str) -> ScenarioWorld:
    """The world of a scenario.

    Raises InputError for an invalid file, an unknown experiment, or one whose flights arrive during
    the hour.
    """
    if is_scenario_file(traffic):
        scenario = load_scenario(Path(traffic))
        names = tuple(each.callsign for each in scenario.aircraft)
        world = _world(scenario.simulator(), _FileScenarios(scenario), scenario.cycles, names)
        return ScenarioWorld(world, len(names), scenario.performance, scenario.cycles)
    task = build_task(load_experiment(traffic).task)
    if not isinstance(task, TrafficTask):
        raise InputError(
            f"traffic {traffic}: an experiment with arriving flights (allowed: a number of flights "
            "per hour, such as 60)"
        )
    world = _world(task.simulator, _TaskScenarios(task), task.cycles, ())
    return ScenarioWorld(world, task.aircraft, task.performance, task.cycles)


def _world(
    simulator: Simulator, scenarios: Scenarios, cycles: int, names: tuple[str, ...]
) -> World:
    return World(
        DrawnFlow(
            replace(simulator, own_navigation=True),
            Clock(0.0),
            slots=max(scenarios.aircraft, _MIN_SLOTS),
            cycles=cycles,
            scenarios=scenarios,
            names=names,
        )
    )


@dataclass(frozen=True)
class _FileScenarios:
    """The aircraft of a scenario file. Its clearances are not issued."""

    scenario: Scenario

    @property
    def aircraft(self) -> int:
        return len(self.scenario.aircraft)

    def draw(self, key: PRNGKeyArray) -> Drawn:
        scenario = self.scenario
        levels = [ticks(float(each.exit_fl)) for each in scenario.aircraft]
        traffic = scenario.initial_traffic(scenario.simulator())
        return Drawn(traffic, jnp.array(levels, dtype=jnp.float32))


@dataclass(frozen=True)
class _TaskScenarios:
    """The random scenarios of a task: with the same key, those of its evaluation."""

    task: TrafficTask

    @property
    def aircraft(self) -> int:
        return self.task.aircraft

    def draw(self, key: PRNGKeyArray) -> Drawn:
        state = self.task.reset(key)
        return Drawn(self.task.traffic(state), self.task.exit_level_ticks(state))
