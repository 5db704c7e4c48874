"""Open a live session under given conditions, and record it in the form of an evaluation."""

from pathlib import Path
from typing import Any, NamedTuple

from msgspec.structs import replace

from skystack.agents.sector_agents import BLUESKY_AGENTS
from skystack.agents.transmission import SectorAgent
from skystack.errors import InputError
from skystack.evaluation.controllers import ControlledWorld, find_controller
from skystack.evaluation.hour_row import write_row
from skystack.evaluation.hour_scores import score, summary
from skystack.evaluation.hour_tables import growing_hours
from skystack.evaluation.scenario_traffic import is_scenario
from skystack.evaluation.traffic import conditions_row, hours_folder, open_hours, record_of
from skystack.evaluation.traffic_conditions import TrafficConditions, check_conditions
from skystack.evaluation.writing import SESSION
from skystack.live.hour import LiveHour
from skystack.platforms.registry import OWN, platform_notes

NOBODY = "no-op"
"""Without an adviser, the world is that of this agent."""


class LiveSession(NamedTuple):
    """A live hour, and what is needed to record it."""

    hour: LiveHour
    adviser: SectorAgent | None
    controlled: ControlledWorld
    conditions: TrafficConditions

    @property
    def notes(self) -> list[str]:
        """What another simulator flies differently than requested."""
        platform = self.conditions.platform
        if platform == OWN or not is_scenario(self.conditions.traffic):
            return []
        traffic, types = self.hour.start.traffic, self.hour.world.simulator.performance.types
        flown = {types[int(kind)] for kind in traffic.kind[traffic.active]}
        return platform_notes(platform, flown, climbs=True)

    def write(self, out: Path, branch: int | None = None) -> tuple[Path, dict[str, Any]]:
        """Write the cycles flown so far; at least one.

        `branch` is the number of a history that is about to be left by going back. Returns the
        folder, which is in `out`, and the row of results.
        """
        conditions = self.conditions._replace(cycles=self.hour.cycle)
        folder, found = hours_folder(out, SESSION, conditions), self.controlled
        ending = "" if branch is None else f"-branch-{branch}"
        folder = folder.with_name(folder.name + ending)
        hour, world = self.hour.recorded(), found.world
        scores = score(world.sector, hour)
        record = replace(record_of(found, conditions), agent=SESSION, safety_net=None)
        with growing_hours(folder, world, found.performance, record) as append:
            append(hour, scores)
        row = summary([scores], SESSION + ending, conditions.recorded_traffic)
        row |= conditions_row(found, conditions) | {"safety_net": None, "per_cycle": None}
        write_row(folder, row)
        return folder, row


def open_session(conditions: TrafficConditions, adviser: str | None = None) -> LiveSession:
    """A live hour under conditions. Raises InputError for invalid ones or an unknown adviser."""
    check_conditions(conditions)
    if adviser in BLUESKY_AGENTS:
        raise InputError(
            f"{adviser} cannot advise: it is part of BlueSky (allowed: any other agent)"
        )
    found = find_controller(adviser or NOBODY, conditions)
    hour = LiveHour(found.world, conditions.seed, hours=open_hours(found, conditions))
    return LiveSession(hour, None if adviser is None else found.agent, found, conditions)
