"""Sessions in dense traffic of X-Plus, for tests."""

from skystack.agents.sector_agents import SECTOR_AGENTS
from skystack.airspace.xplus import x_plus
from skystack.evaluation.controllers import ControlledWorld
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.live.hour import LiveHour
from skystack.live.recorded import LiveSession
from skystack.simulator.arrival_flows import Flow, constant_rate
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.tasks.sector_world import World

ADVISER = "own-navigation-exit-level"
"""An adviser that compiles nothing: every flight goes direct, at its exit level."""
WORLD = World(
    Flow(
        Simulator(x_plus(), performance("constant"), own_navigation=True),
        constant_rate(600.0),
        slots=32,
        candidates=64,
    )
)


def begun_hour(seed=3, flights=3):
    """An hour, flown until this many flights are on frequency."""
    hour = LiveHour(WORLD, seed=seed)
    while sum(hour.state.hears) < flights:
        hour.advance()
    return hour


def on_frequency(hour):
    """The callsigns of the flights on frequency."""
    return [name for name, slot in hour.slots.items() if hour.state.hears[slot]]


def opened(seed=3, cycles=600):
    """A session at its start, with an adviser."""
    agent = SECTOR_AGENTS[ADVISER](WORLD, 5)
    controlled = ControlledWorld(ADVISER, agent, WORLD, "constant", 5, "")
    conditions = TrafficConditions("600", seed=seed, cycles=cycles)
    return LiveSession(LiveHour(WORLD, seed), agent, controlled, conditions)
