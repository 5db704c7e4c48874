"""Scenarios without arrivals, flown in another simulator, for agents of sector control.

The state that agents see is rebuilt from the simulator's reports after every cycle. Exits,
excursions and losses of separation are determined as in our simulator.
"""

from contextlib import ExitStack
from typing import Any

import numpy as np

from skystack.agents.callsigns import Callsigns
from skystack.agents.transmission import Transmission
from skystack.compilation.fetch import fetched
from skystack.compilation.shared import shared_program
from skystack.evaluation.foreign_hours import instructions_of
from skystack.io.files import scratch_folder
from skystack.learning.seeds import scenario_key
from skystack.platforms.conversion import scenario_of, traffic_of
from skystack.platforms.protocol import Report
from skystack.platforms.registry import open_platform
from skystack.simulator.traffic import Traffic
from skystack.tasks.sector_world import World, WorldCycle, WorldState


class ScenarioHours:
    """Implements `skystack.evaluation.hours.Hours` on a platform.

    The flow of `world` is a `DrawnFlow`; `performance` is the name of its performance model.
    """

    def __init__(self, world: World, platform: str, performance: str) -> None:
        self.world, self._performance = world, performance
        with ExitStack() as resources:
            folder = resources.enter_context(scratch_folder("skystack-"))
            self.platform = open_platform(platform, folder)
            resources.callback(self.platform.close)
            self._resources = resources.pop_all()
        self._reset = shared_program(world.reset)
        self._end_cycle = shared_program(world.end_cycle)
        self._slot: dict[str, int] = {}
        """The slots of all flights of the scenario, by callsign."""

    def reset(self, seed: int, number: int) -> WorldState:
        state: WorldState = fetched(self._reset(scenario_key(seed, number)))
        self._slot = Callsigns(self.world.flow.callsigns).follow(state)
        scenario = scenario_of(
            state.traffic,
            self.world.simulator,
            self._performance,
            self.world.flow.cycles,
            list(self._slot),
            state.arrivals.exit_level_ticks,
        )
        return state._replace(traffic=self._read(self.platform.reset(scenario), state.traffic))

    def advance(
        self, state: WorldState, transmissions: list[Transmission]
    ) -> tuple[WorldState, WorldCycle]:
        flown = state.traffic
        if flown.active.any():  # once all have left, the platform may have none to report
            for each in instructions_of(self.world, state.traffic, self._slot, transmissions):
                self.platform.issue(each)
            flown = self._read(self.platform.advance(), _on_routes(state.traffic, transmissions))
        arrivals = state.arrivals._replace(cycle=state.arrivals.cycle + 1)
        nobody = np.zeros_like(state.traffic.active)
        next_state, cycle = fetched(self._end_cycle(state.progress, flown, nobody, arrivals, flown))
        return _past_fixes(next_state), cycle

    def close(self) -> None:
        self._resources.close()

    def _read(self, report: Report, before: Traffic) -> Traffic:
        """The traffic with what is reported of its flights, which are in the first slots."""
        free = len(before.active) - len(report.fl)
        padded = Report(*(np.pad(values, (0, free)) for values in report))
        read: Traffic = fetched(traffic_of(padded, before, self.world.sector.plane))
        return read


def _on_routes(traffic: Traffic, transmissions: list[Transmission]) -> Traffic:
    """The traffic with own navigation and fixes as transmitted; platforms do not report them."""
    own = np.array(traffic.own_navigation)
    fix, cleared = np.array(traffic.next_fix), np.array(traffic.cleared_fix)
    for each in transmissions:
        if each.heading_deg is not None:
            own[each.slot] = False
        if each.fix is not None:
            own[each.slot], fix[each.slot], cleared[each.slot] = True, each.fix, each.fix
    changed: Any = {"own_navigation": own, "next_fix": fix, "cleared_fix": cleared}
    return traffic._replace(**changed)


def _past_fixes(state: WorldState) -> WorldState:
    """The state with each flight's next fix: the later of the one that it was cleared to and the
    first that it has not passed. Platforms do not report it.
    """
    following: Any = np.maximum(state.traffic.next_fix, state.progress.next_fix)
    return state._replace(traffic=state.traffic._replace(next_fix=following))
