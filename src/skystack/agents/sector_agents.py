"""The agents of sector control by name, and learned ones from policies."""

from collections.abc import Callable
from typing import Any

from skystack.agents.learned import Learned
from skystack.agents.search import Search
from skystack.agents.sector_rules import NoOp, OwnNavigation, Rules
from skystack.agents.transmission import SectorAgent
from skystack.errors import InputError
from skystack.learning.experiment import experiment_from
from skystack.learning.policy import Policy
from skystack.tasks.registry import build_task
from skystack.tasks.sector_control import SectorControl
from skystack.tasks.sector_world import World

SECTOR_AGENTS: dict[str, Callable[[World, int], SectorAgent]] = {
    "no-op": lambda world, per_cycle: NoOp(),
    "own-navigation": lambda world, per_cycle: OwnNavigation(False, per_cycle),
    "own-navigation-exit-level": lambda world, per_cycle: OwnNavigation(True, per_cycle),
    "rules": Rules,
    "search": Search,
}
"""Makes an agent for a world and a maximum number of transmissions in a cycle, by its name."""


def sector_task_of(policy: Policy) -> SectorControl:
    """The task that a policy was trained on. Raises InputError if it is not sector control."""
    described = policy.description
    if described.task_name != SectorControl.name:
        raise InputError(
            f"the policy was trained on task {described.task_name} (allowed with --traffic: "
            f"{SectorControl.name})"
        )
    task: Any = build_task(experiment_from(described.config, "policy.json").task)
    if described.task_version != task.version:
        raise InputError(
            f"the policy was trained on version {described.task_version} of {task.name} (allowed: "
            f"{task.version})"
        )
    known = (described.observation, described.actions)
    if known != (task.observation_names, task.action_names):
        raise InputError("the policy has other observations or actions than its task")
    found: SectorControl = task
    return found


def learned_agent(policy: Policy, world: World, per_cycle: int) -> Learned:
    """The agent that flies a policy in a world."""
    task = sector_task_of(policy)
    return Learned(policy, SectorControl(world.flow, task.cycles, task.reward), per_cycle)
