"""Evaluate a controller of a sector on hours of arriving traffic."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skystack.agents.sector_agents import SECTOR_AGENTS, learned_agent, sector_task_of
from skystack.agents.transmission import PER_CYCLE, SectorAgent
from skystack.airspace.sector import Sector
from skystack.airspace.sectors import sector_from, sector_setting
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError, exists, unknown_name
from skystack.evaluation.hour_row import forget_row, write_row
from skystack.evaluation.hour_scores import score, summary
from skystack.evaluation.hour_tables import AppendHour, growing_hours
from skystack.evaluation.hours import HourFlyer, Hours, OwnHours
from skystack.evaluation.writing import TrafficRecord
from skystack.learning.policy import Policy
from skystack.platforms.registry import OWN, check_platform
from skystack.policies.shipped import find_policy, shipped_policies
from skystack.simulator.arrival_flows import FLIGHT_SCHOOL, STARTERS, Flow, constant_rate
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.tasks.sector_control import SectorControl
from skystack.tasks.sector_world import World

SPEED_SPREAD, CLIMB_SPREAD = 0.03, 0.10
"""The spread of airspeeds and of rates of climb and descent with `uncertainty`."""
PERFORMANCE = "constant"
"""The performance model of agents that are not policies, which is that of BluebirdDT's traffic."""
BLUEBIRD = "bluebird"
"""The other platform in which hours can be flown."""
_SLOTS = (16, 32, 64, 128, 256)


class TrafficConditions(NamedTuple):
    """The traffic of an evaluation, and what the controller is allowed."""

    traffic: str
    """Flights per hour, or a name in `FLIGHT_SCHOOL`."""
    hours: int = 1
    seed: int = 0
    per_cycle: int = PER_CYCLE
    """The maximum number of transmissions in a cycle."""
    cycles: int = 600
    """The length of an hour in cycles; shorter values are for quick checks."""
    sector: str | None = None
    """A sector to use instead of the agent's."""
    uncertainty: bool = False
    """Whether speeds and rates of climb differ from the nominal ones at random."""
    safety_net: bool = True
    """Whether a policy flies with its safety net."""
    platform: str = OWN
    """The simulator, `skystack` or `bluebird`."""

    @property
    def options(self) -> list[str]:
        """`--per-cycle`, `--uncertainty`, `--no-safety-net` and `--platform`, unless at default."""
        differs = {
            f"--per-cycle {self.per_cycle}": self.per_cycle != PER_CYCLE,
            "--uncertainty": self.uncertainty,
            "--no-safety-net": not self.safety_net,
            f"--platform {self.platform}": self.platform != OWN,
        }
        return [option for option, given in differs.items() if given]


def flow_of(conditions: TrafficConditions, simulator: Simulator) -> Flow:
    """The arrivals of the named traffic. Raises InputError for unknown traffic."""
    traffic = conditions.traffic
    if traffic in FLIGHT_SCHOOL:
        flow = Flow(simulator, FLIGHT_SCHOOL[traffic], starters=STARTERS)
    else:
        flow = _constant_flow(traffic, simulator)
    if conditions.uncertainty:
        flow = replace(flow, speed_spread=SPEED_SPREAD, climb_spread=CLIMB_SPREAD)
    return replace(flow, cycles=conditions.cycles)


def traffic_name(traffic: str) -> str:
    """Traffic as it is written in rows: `60` for `60.0`. Invalid traffic is left as it is."""
    try:
        return traffic if traffic in FLIGHT_SCHOOL else f"{float(traffic):g}"
    except ValueError:
        return traffic


def _constant_flow(traffic: str, simulator: Simulator) -> Flow:
    try:
        rate = float(traffic)
    except ValueError:
        raise InputError(
            f"traffic {traffic!r} (allowed: flights per hour, or {', '.join(FLIGHT_SCHOOL)})"
        ) from None
    clock = constant_rate(rate)
    # About a quarter of the flights of an hour are there at once.
    slots = next((each for each in _SLOTS if each >= 0.45 * rate + 8.0), _SLOTS[-1])
    return Flow(simulator, clock, slots=slots)


def evaluate_traffic(
    controller: str | Policy,
    conditions: TrafficConditions,
    out: Path | None = None,
    on_cycle: Callable[[int], None] = lambda cycle: None,
) -> dict[str, Any]:
    """Fly hours of traffic under an agent; returns the row of results.

    `controller` is a policy, the name of a shipped one or a folder with one, or one of
    `SECTOR_AGENTS`. With `out`, tables are written into a subfolder of it (`hours_folder`). Raises
    InputError for invalid conditions.
    """
    check_conditions(conditions)
    found = find_controller(controller, conditions)
    folder = None if out is None else hours_folder(out, found.name, conditions)
    scores, cycles = [], count(1)
    with _tables_in(folder, found, conditions) as append, _hours_of(found, conditions) as hours:
        flyer = HourFlyer(found.world, conditions.cycles, conditions.per_cycle, hours)
        for number in range(conditions.hours):
            hour = flyer.fly(found.agent, conditions.seed, number, lambda _: on_cycle(next(cycles)))
            scores.append(score(found.world.sector, hour))
            append(hour, scores[-1])
        if folder is not None:  # the row is never older than the tables
            forget_row(folder)
    row = summary(scores, found.name, conditions.traffic) | {
        "sector": found.world.sector.name,
        "seed": conditions.seed,
        "cycles": conditions.cycles,
        "per_cycle": conditions.per_cycle,
        "uncertainty": conditions.uncertainty,
        "safety_net": found.safety_net,
        "platform": conditions.platform,
    }
    if folder is not None:
        write_row(folder, row)
    return row


def check_conditions(conditions: TrafficConditions) -> None:
    """Raise InputError for conditions that the platform cannot fly."""
    platform = conditions.platform
    check_platform(platform)
    if platform == OWN:
        return
    if platform != BLUEBIRD:
        raise InputError(f"--platform {platform} (allowed with --traffic: {OWN}, {BLUEBIRD})")
    if conditions.traffic not in FLIGHT_SCHOOL:
        raise InputError(
            f"traffic {conditions.traffic} in BluebirdDT (allowed: {', '.join(FLIGHT_SCHOOL)})"
        )
    for option, given in (("sector", conditions.sector), ("uncertainty", conditions.uncertainty)):
        if given:
            raise InputError(f"--{option} cannot be used with --platform {platform}")


@contextmanager
def _hours_of(found: "ControlledWorld", conditions: TrafficConditions) -> Iterator[Hours]:
    """Open the simulator that flies the hours."""
    if conditions.platform == OWN:
        yield OwnHours(found.world)
        return
    from skystack.evaluation.bluebird_hours import BluebirdHours  # noqa: PLC0415  # an extra

    if found.performance != PERFORMANCE:
        raise InputError(
            f"a policy for performance {found.performance} (allowed in BluebirdDT's traffic: "
            f"{PERFORMANCE})"
        )
    if not _is_x_plus(found.world.sector):
        name = found.world.sector.name
        raise InputError(f"a policy for sector {name} (allowed in BluebirdDT's traffic: x-plus)")
    with closing(BluebirdHours(found.world, FLIGHT_SCHOOL[conditions.traffic])) as hours:
        yield hours


def _is_x_plus(sector: Sector) -> bool:
    """Whether a sector is X-Plus, by whatever name."""
    ours = x_plus()
    if set(sector.routes) != set(ours.routes) or sector.levels_fl != ours.levels_fl:
        return False
    names = sorted(ours.fixes)
    one, two = (np.array([of.fixes[name] for name in names]) for of in (sector, ours))
    return np.allclose(one, two, atol=1e-4) and len(sector.area) == len(ours.area)


class ControlledWorld(NamedTuple):
    """An agent and the world that it controls."""

    name: str
    agent: SectorAgent
    world: World
    performance: str
    """The name of the performance model in this world."""

    @property
    def safety_net(self) -> bool | None:
        """Whether the agent flies with its safety net; None if it has none."""
        return getattr(self.agent, "safety_net", None)


def find_controller(controller: str | Policy, conditions: TrafficConditions) -> ControlledWorld:
    """The agent of a name or a policy. Raises InputError if it or its conditions are invalid."""
    if isinstance(controller, str) and controller in SECTOR_AGENTS:
        if not conditions.safety_net:
            raise InputError(
                f"{controller} has no safety net (allowed: --no-safety-net only with a policy)"
            )
        world = _world(conditions, "x-plus", PERFORMANCE)
        agent = SECTOR_AGENTS[controller](world, conditions.per_cycle)
        return ControlledWorld(controller, agent, world, PERFORMANCE)
    policy = controller if isinstance(controller, Policy) else _policy(controller)
    task, config = sector_task_of(policy), policy.description.config["task"]
    world = _world(conditions, task.sector, config["performance"])
    agent = learned_agent(policy, task, world, conditions.per_cycle, conditions.safety_net)
    name = policy.description.experiment
    if isinstance(controller, str) and controller not in shipped_policies():
        name += f"-s{policy.description.seed}"
    return ControlledWorld(name, agent, world, config["performance"])


def _world(conditions: TrafficConditions, sector: str | Sector, model: str) -> World:
    """The world of a sector, or of that of the conditions, with a performance model."""
    if conditions.sector is not None:
        sector = conditions.sector
    if isinstance(sector, str):
        sector = sector_from(sector_setting(sector))
    return World(flow_of(conditions, Simulator(sector, performance(model), own_navigation=True)))


def _policy(name: str) -> Policy:
    if name not in shipped_policies() and not exists(name):
        also = "a folder with a policy.json, or "
        raise unknown_name("agent", name, [*SECTOR_AGENTS, SectorControl.name], also=also)
    return find_policy(name)


def hours_folder(out: Path, agent: str, conditions: TrafficConditions) -> Path:
    """The folder of the tables of an agent on some traffic."""
    name = f"{agent}-traffic-{conditions.traffic}-seed-{conditions.seed}"
    if conditions.sector is not None:
        name += f"-{Path(conditions.sector).stem}"
    options = (each.removeprefix("--").replace(" ", "-") for each in conditions.options)
    return out / "-".join([name, *options])


def _tables_in(
    folder: Path | None, found: ControlledWorld, conditions: TrafficConditions
) -> AbstractContextManager[AppendHour]:
    """Open the tables in a folder; without one, nothing is written."""
    if folder is None:
        return nullcontext(lambda hour, scores: None)
    traffic = TrafficRecord(
        found.name,
        conditions.traffic,
        conditions.seed,
        conditions.uncertainty,
        found.safety_net,
        conditions.platform,
    )
    return growing_hours(folder, found.world, found.performance, traffic)
