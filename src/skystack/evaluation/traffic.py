"""Evaluate a controller of a sector on hours of arriving traffic."""

from collections.abc import Callable
from contextlib import AbstractContextManager, closing, nullcontext
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from skystack.agents.sector_agents import BLUESKY_AGENTS
from skystack.airspace.sector import Sector
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.evaluation.controllers import PERFORMANCE, ControlledWorld, find_controller
from skystack.evaluation.fixed_traffic import fixed_platform, is_fixed
from skystack.evaluation.hour_row import write_row
from skystack.evaluation.hour_scores import score, summary
from skystack.evaluation.hour_tables import AppendHour, growing_hours
from skystack.evaluation.hours import HourFlyer, Hours, OwnHours
from skystack.evaluation.scenario_hours import ScenarioHours
from skystack.evaluation.scenario_traffic import is_scenario
from skystack.evaluation.traffic_conditions import BLUESKY, TrafficConditions, check_conditions
from skystack.evaluation.writing import TrafficRecord
from skystack.learning.policy import Policy
from skystack.platforms.registry import OWN
from skystack.simulator.arrival_flows import FLIGHT_SCHOOL


def evaluate_traffic(
    controller: str | Policy,
    conditions: TrafficConditions,
    out: Path | None = None,
    on_cycle: Callable[[int], None] = lambda cycle: None,
) -> dict[str, Any]:
    """Fly hours of traffic under an agent; returns the row of results.

    `controller` is a policy or a name, as in `find_controller`. With `out`, tables are written into
    a subfolder of it (`hours_folder`). Raises InputError for invalid conditions.
    """
    check_conditions(conditions)
    found = find_controller(controller, conditions)
    folder = None if out is None else hours_folder(out, found.name, conditions)
    scores, cycles = [], count(1)
    with (
        _tables_in(folder, found, conditions) as append,
        closing(open_hours(found, conditions)) as hours,
    ):
        flyer = HourFlyer(found.world, conditions.cycles, found.per_cycle, hours)
        for number in range(conditions.hours):
            hour = flyer.fly(found.agent, conditions.seed, number, lambda _: on_cycle(next(cycles)))
            scores.append(score(found.world.sector, hour))
            append(hour, scores[-1])
    row = summary(scores, found.name, conditions.recorded_traffic) | conditions_row(
        found, conditions
    )
    if folder is not None:
        write_row(folder, row)
    return row


def conditions_row(found: ControlledWorld, conditions: TrafficConditions) -> dict[str, Any]:
    """The part of a row of results that describes the conditions."""
    return {
        "sector": found.world.sector.name,
        "seed": conditions.seed,
        "cycles": conditions.cycles,
        "per_cycle": found.per_cycle,
        "uncertainty": conditions.uncertainty,
        "safety_net": found.safety_net,
        "platform": conditions.platform,
    }


def open_hours(found: ControlledWorld, conditions: TrafficConditions) -> Hours:
    """The simulator that flies the hours. Raises InputError if it cannot fly this world."""
    if conditions.platform == OWN:
        return OwnHours(found.world)
    platform = conditions.platform
    if is_scenario(conditions.traffic):
        if found.name in BLUESKY_AGENTS:
            raise InputError(f"{found.name} with a scenario (allowed: arriving traffic in BlueSky)")
        return ScenarioHours(found.world, platform, found.performance)
    if is_fixed(conditions.traffic):
        from skystack.evaluation.bluebird_hours import BluebirdHours  # noqa: PLC0415  # an extra

        return BluebirdHours(found.world, fixed_platform(conditions.traffic))
    if found.performance != PERFORMANCE:
        raise InputError(
            f"a policy for performance {found.performance} (allowed with --platform {platform}: "
            f"{PERFORMANCE})"
        )
    if platform == BLUESKY:
        from skystack.evaluation.bluesky_hours import BlueskyHours  # noqa: PLC0415  # an extra

        return BlueskyHours(found.world, avoids=found.name in BLUESKY_AGENTS)
    from skystack.evaluation.bluebird_hours import BluebirdHours  # noqa: PLC0415  # an extra

    if not _is_x_plus(found.world.sector):
        name = found.world.sector.name
        raise InputError(f"a policy for sector {name} (allowed in BluebirdDT's traffic: x-plus)")
    from skystack.platforms.bluebird_traffic import FlightSchoolTraffic  # noqa: PLC0415

    return BluebirdHours(found.world, FlightSchoolTraffic(FLIGHT_SCHOOL[conditions.traffic]))


def _is_x_plus(sector: Sector) -> bool:
    """Whether a sector is X-Plus, by whatever name."""
    ours = x_plus()
    if set(sector.routes) != set(ours.routes) or sector.levels_fl != ours.levels_fl:
        return False
    names = sorted(ours.fixes)
    one, two = (np.array([of.fixes[name] for name in names]) for of in (sector, ours))
    return np.allclose(one, two, atol=1e-4) and len(sector.area) == len(ours.area)


def hours_folder(out: Path, agent: str, conditions: TrafficConditions) -> Path:
    """The folder of the tables of an agent on some traffic."""
    name = f"{agent}-traffic-{conditions.traffic_in_names}-seed-{conditions.seed}"
    return out / "-".join([name, *conditions.options_in_names])


def _tables_in(
    folder: Path | None, found: ControlledWorld, conditions: TrafficConditions
) -> AbstractContextManager[AppendHour]:
    """Open the tables in a folder; without one, nothing is written."""
    if folder is None:
        return nullcontext(lambda hour, scores: None)
    traffic = record_of(found, conditions)
    return growing_hours(folder, found.world, found.performance, traffic)


def record_of(found: ControlledWorld, conditions: TrafficConditions) -> TrafficRecord:
    """The traffic and the agent, as tables record them."""
    return TrafficRecord(
        found.name,
        conditions.recorded_traffic,
        conditions.seed,
        conditions.uncertainty,
        found.safety_net,
        conditions.platform,
    )
