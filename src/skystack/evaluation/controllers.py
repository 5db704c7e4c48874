"""Find controllers of a sector by name, and the worlds that they control."""

import os
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from skystack.agents.agent import Agent, check_agent
from skystack.agents.find import READERS, find_agent
from skystack.agents.per_flight import PerFlight
from skystack.agents.scenario_agent import ScenarioAgent, check_fits_scenario
from skystack.agents.sector_agents import (
    BLUESKY_AGENTS,
    SECTOR_AGENTS,
    learned_agent,
    navigation_task_of,
    sector_task_of,
)
from skystack.agents.transmission import PER_CYCLE, SectorAgent
from skystack.agents.user_code import UserController
from skystack.agents.user_modules import (
    find_user_code,
    is_file_name,
    is_user_code,
    user_code_file,
)
from skystack.airspace.sector import Sector
from skystack.airspace.sectors import sector_from, sector_setting
from skystack.errors import InputError, exists, unknown_name
from skystack.evaluation.fixed_traffic import fixed_world, is_fixed
from skystack.evaluation.scenario_traffic import is_scenario, scenario_world
from skystack.evaluation.traffic_conditions import BLUESKY, TrafficConditions, flow_of
from skystack.io.files import file_digest, read_whole
from skystack.io.names import as_name
from skystack.learning.policy import Policy
from skystack.policies.shipped import find_policy, shipped_policies
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.tasks.sector_control import SectorControl
from skystack.tasks.sector_rewards import SectorRewardSettings
from skystack.tasks.sector_world import World

ALIASES = {"noop": "no-op"}
"""Other spellings of names."""
DEFAULT_SECTOR = "x-plus"
"""The sector of agents that are not policies."""
PERFORMANCE = "constant"
"""The performance model of agents that are not policies, which is that of BluebirdDT's traffic."""


class ControlledWorld(NamedTuple):
    """An agent and the world that it controls."""

    name: str
    agent: SectorAgent
    world: World
    performance: str
    """The name of the performance model in this world."""
    per_cycle: int | None
    """The maximum number of transmissions in a cycle; None without a limit."""
    digest: str
    """Identifies the agent. Of users' code, it covers the file with the class, but not what that
    imports."""

    @property
    def safety_net(self) -> bool | None:
        """Whether the agent flies with its safety net; None if it has none."""
        return getattr(self.agent, "safety_net", None)

    @property
    def runs_user_code(self) -> bool:
        """Whether the agent is a user's class, which may keep state anywhere."""
        return isinstance(self.agent, UserController)


def find_controller(controller: str | Policy, conditions: TrafficConditions) -> ControlledWorld:
    """The agent of a policy or a name. Raises InputError if it or its conditions are invalid.

    A name is that of an agent (`SECTOR_AGENTS`, `BLUESKY_AGENTS`, or one of `ALIASES`) or of a
    shipped policy, a folder with a policy, a policy file of another library, or a class
    `module:Class` (`skystack.agents.user_code`).
    """
    if isinstance(controller, Policy):
        return _learned(controller, controller.description.experiment, conditions)
    name = ALIASES.get(controller, controller)
    if is_file_name(name):
        raise InputError(f"{name} has no class (allowed: {name}:Class)")
    if name in shipped_policies() or _is_folder(name):
        policy = find_policy(name)
        row = policy.description.experiment
        if name not in shipped_policies():
            row += f"-s{policy.description.seed}"
        return _learned(policy, row, conditions)
    if not conditions.safety_net:
        raise InputError(f"{name} has no safety net (allowed: --no-safety-net only with a policy)")
    if name in BLUESKY_AGENTS and conditions.platform != BLUESKY:
        raise InputError(f"{name} flies in BlueSky only (allowed: --platform {BLUESKY})")
    if make := (SECTOR_AGENTS | BLUESKY_AGENTS).get(name):
        (world, model), per_cycle = _world(conditions), _per_cycle(conditions)
        return ControlledWorld(name, make(world, per_cycle), world, model, per_cycle, name)
    if is_user_code(name):
        return _user_code(name, conditions)
    if Path(name).suffix.lower() in READERS:
        return _other_library(name, conditions)
    also = "a folder with a policy.json, an .onnx or .zip file, module:Class, or "
    raise unknown_name(
        "agent", name, [*SECTOR_AGENTS, *BLUESKY_AGENTS, SectorControl.name], also=also
    )


def _is_folder(name: str) -> bool:
    """Whether a name is that of a policy's folder or file, which may be damaged."""
    if not name or not exists(name) or Path(name).suffix.lower() in READERS:
        return False
    return Path(name).is_dir() or not is_user_code(name)


def _learned(policy: Policy, name: str, conditions: TrafficConditions) -> ControlledWorld:
    if is_scenario(conditions.traffic) and policy.description.task_name != SectorControl.name:
        return _learned_in_scenario(policy, name, conditions)
    task, config = sector_task_of(policy), policy.description.config["task"]
    world, model = _world(conditions, task.sector, config["performance"])
    per_cycle = _per_cycle(conditions)
    agent = learned_agent(policy, task, world, per_cycle, conditions.safety_net)
    digest = policy.description.sha256
    return ControlledWorld(name, agent, world, model, per_cycle, digest)


def _learned_in_scenario(
    policy: Policy, name: str, conditions: TrafficConditions
) -> ControlledWorld:
    """A policy of another task, in a scenario without arrivals."""
    if not conditions.safety_net:
        raise InputError(
            f"{name} has no safety net (allowed: --no-safety-net only with a policy of sector "
            "control)"
        )
    found = scenario_world(conditions.traffic)
    task, world = navigation_task_of(policy), found.world
    check_fits_scenario(task, world.sector, found.aircraft)
    return ControlledWorld(
        name,
        ScenarioAgent(policy, task),
        world,
        found.performance,
        _per_cycle(conditions),
        policy.description.sha256,
    )


def _user_code(name: str, conditions: TrafficConditions) -> ControlledWorld:
    """A user's class, without a limit of transmissions unless one is given.

    Its code is executed when the first hour begins.
    """
    where, _, member = name.rpartition(":")
    file = user_code_file(name)
    world, model = _world(conditions)
    agent = UserController(partial(find_user_code, name), _task(world, conditions))
    # The same text in another folder may import other modules.
    source = b"" if file is None else os.fsencode(file.resolve()) + b"\0" + read_whole(file)
    digest = sha256(member.encode() + b"\0" + source).hexdigest()
    row = as_name(f"{Path(where).stem if is_file_name(where) else where}.{member}")
    return ControlledWorld(row, agent, world, model, conditions.per_cycle, digest)


def _other_library(name: str, conditions: TrafficConditions) -> ControlledWorld:
    found = find_agent(name)
    assert isinstance(found, Agent), "the readers make agents"
    (world, model), per_cycle = _world(conditions), _per_cycle(conditions)
    task = _task(world, conditions)
    check_agent(found, task, SectorControl.name)
    digest = file_digest(Path(name))
    agent = PerFlight(found, task, per_cycle)
    # With its suffix, so that a file `no-op.onnx` is not taken for `no-op`.
    row = as_name(Path(name).name)
    return ControlledWorld(row, agent, world, model, per_cycle, digest)


def _per_cycle(conditions: TrafficConditions) -> int:
    return PER_CYCLE if conditions.per_cycle is None else conditions.per_cycle


def _task(world: World, conditions: TrafficConditions) -> SectorControl:
    return SectorControl(world.flow, conditions.cycles, SectorRewardSettings())


def _world(
    conditions: TrafficConditions, sector: str | Sector = DEFAULT_SECTOR, model: str = PERFORMANCE
) -> tuple[World, str]:
    """The world of the traffic, and the name of its performance model.

    Scenarios and fixed traffic have their own. The speeds of fixed traffic, sampled from
    BluebirdDT, are recorded as `table`.
    """
    if is_fixed(conditions.traffic):
        return fixed_world(conditions.traffic, conditions.cycles), "table"
    if is_scenario(conditions.traffic):
        found = scenario_world(conditions.traffic)
        return found.world, found.performance
    if conditions.sector is not None:
        sector = conditions.sector
    if isinstance(sector, str):
        sector = sector_from(sector_setting(sector))
    simulator = Simulator(sector, performance(model), own_navigation=True)
    return World(flow_of(conditions, simulator)), model
