"""The agents of sector control by name, and learned ones from policies."""

from collections.abc import Callable
from typing import TypeVar

from skystack.agents.learned import Learned, weights_of
from skystack.agents.policy_queries import Queries
from skystack.agents.search import Search
from skystack.agents.sector_rules import Mvp, NoOp, OwnNavigation, Rules
from skystack.agents.transmission import SectorAgent
from skystack.errors import InputError
from skystack.learning.experiment import experiment_from
from skystack.learning.policy import Policy
from skystack.policies.facts import check_trained_for
from skystack.tasks.navigation import NavigationTask
from skystack.tasks.registry import build_task
from skystack.tasks.sector_control import SectorControl
from skystack.tasks.sector_world import World

SomeTask = TypeVar("SomeTask", SectorControl, NavigationTask)

SECTOR_AGENTS: dict[str, Callable[[World, int], SectorAgent]] = {
    "no-op": lambda world, per_cycle: NoOp(),
    "own-navigation": lambda world, per_cycle: OwnNavigation(False, per_cycle),
    "own-navigation-exit-level": lambda world, per_cycle: OwnNavigation(True, per_cycle),
    "rules": Rules,
    "search": Search,
}
"""Makes an agent for a world and a maximum number of transmissions in a cycle, by its name."""
BLUESKY_AGENTS: dict[str, Callable[[World, int], SectorAgent]] = {
    "mvp": lambda world, per_cycle: Mvp(True, per_cycle),
}
"""The same for agents that fly in BlueSky only."""


def sector_task_of(policy: Policy) -> SectorControl:
    """The task that a policy was trained on. Raises InputError if it is not sector control."""
    return _task_of(policy, SectorControl, f"with this traffic: {SectorControl.name}")


def navigation_task_of(policy: Policy) -> NavigationTask:
    """The task that a policy was trained on. Raises InputError if it is not a navigation task."""
    allowed = f"in a scenario: the tasks of the paper, and {SectorControl.name}"
    return _task_of(policy, NavigationTask, allowed)


def _task_of(policy: Policy, kind: type[SomeTask], allowed: str) -> SomeTask:
    described = policy.description
    where = f"policy {described.experiment}-s{described.seed}"
    task = build_task(experiment_from(described.config, where).task)
    check_trained_for(task, described, where)
    if not isinstance(task, kind):
        raise InputError(f"the policy was trained on task {task.name} (allowed {allowed})")
    return task


def learned_agent(
    policy: Policy, task: SectorControl, world: World, per_cycle: int, safety_net: bool = True
) -> Learned:
    """The agent that flies a policy, trained on a task, in a world."""
    flown = SectorControl(world.flow, task.cycles, task.reward)
    return Learned(Queries(flown), weights_of(policy), per_cycle, safety_net)
