"""Hours of our arriving traffic, flown in BlueSky, for agents of sector control.

The flights and the rule that admits them are ours. The state that agents see is rebuilt from
BlueSky's traffic after every cycle. Exits, excursions and losses of separation are determined as in
our simulator.
"""

from jaxtyping import Array

from skystack.agents.callsigns import Callsigns
from skystack.agents.transmission import Transmission
from skystack.compilation.fetch import fetched
from skystack.compilation.shared import shared_program
from skystack.evaluation.foreign_hours import ReportedTraffic, instructions_of
from skystack.learning.seeds import scenario_key
from skystack.platforms.bluesky_traffic import BlueskyTraffic, Newborn
from skystack.simulator.arrivals import Arrivals, count_cycle
from skystack.simulator.performance import TICKS_PER_FL, ConstantPerformance
from skystack.simulator.traffic import Traffic
from skystack.tasks.progress import Progress
from skystack.tasks.sector_world import World, WorldCycle, WorldState

FEET_PER_FL = 100.0


class BlueskyHours:
    """Implements `skystack.evaluation.hours.Hours` in BlueSky.

    With `avoids`, BlueSky's MVP manoeuvres the flights away from each other.
    """

    def __init__(self, world: World, avoids: bool = False) -> None:
        self.world, sector = world, world.sector
        self.platform = BlueskyTraffic(
            sector.fixes, avoids, sector.separation_nm, FEET_PER_FL * sector.separation_fl
        )
        self._reports = ReportedTraffic(world)
        self._reset, self._admit = shared_program(world.reset), shared_program(world.admit)
        self._end_cycle = shared_program(_end_cycle, world)
        self._callsigns = Callsigns(world.flow.callsigns)
        self._flying: dict[str, int] = {}
        """The slots of the flights that BlueSky flies, by callsign."""

    def reset(self, seed: int, number: int) -> WorldState:
        state: WorldState = fetched(self._reset(scenario_key(seed, number)))
        self.platform.reset()
        self._callsigns, self._flying = Callsigns(self.world.flow.callsigns), {}
        return state

    def advance(
        self, state: WorldState, transmissions: list[Transmission]
    ) -> tuple[WorldState, WorldCycle]:
        arrivals, begun, born = fetched(self._admit(state.arrivals, state.traffic))
        slots = self._callsigns.follow(state._replace(arrivals=arrivals))
        for callsign, slot in slots.items():
            if callsign not in self._flying and arrivals.held[slot] == 0:
                self.platform.enter(callsign, self._newborn(arrivals, begun, slot))
                self._flying[callsign] = slot
        for each in instructions_of(self.world, begun, self._flying, transmissions):
            self.platform.issue(each)
        reports = self.platform.advance()
        flown = self._reports.read(begun, self._flying, reports)
        next_state, cycle = fetched(self._end_cycle(state.progress, begun, born, arrivals, flown))
        for callsign, slot in list(self._flying.items()):
            if not next_state.traffic.active[slot]:
                self.platform.remove(callsign)
                del self._flying[callsign]
        return next_state, cycle

    def close(self) -> None:
        self.platform.close()

    def _newborn(self, arrivals: Arrivals, traffic: Traffic, slot: int) -> Newborn:
        performance = self.world.simulator.performance
        assert isinstance(performance, ConstantPerformance), "checked by `open_hours`"
        speed, rate = traffic.airspeed_factor, traffic.climb_factor
        assert speed is not None, "arrivals have one"
        assert rate is not None, "arrivals have one"
        lat, lon = self.world.sector.plane.to_degrees(traffic.position_nm[slot])
        return Newborn(
            route=tuple(self.world.sector.routes[int(traffic.route[slot])]),
            entry_fl=float(arrivals.entry_level_ticks[slot]) / TICKS_PER_FL,
            exit_fl=float(arrivals.exit_level_ticks[slot]) / TICKS_PER_FL,
            lat=float(lat),
            lon=float(lon),
            heading_deg=float(traffic.heading_deg[slot]) % 360.0,
            airspeed_kt=performance.airspeed_kt * float(speed[slot]),
            rate_ft_min=performance.rate_ft_min * float(rate[slot]),
        )


def _end_cycle(
    world: World,
    progress: Progress,
    begun: Traffic,
    born: Array,
    arrivals: Arrivals,
    flown: Traffic,
) -> tuple[WorldState, WorldCycle]:
    return world.end_cycle(progress, begun, born, count_cycle(arrivals), flown)
