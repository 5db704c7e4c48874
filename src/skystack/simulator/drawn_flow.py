"""Traffic without arrivals: all flights of a scenario are there at the start."""

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from skystack.simulator.arrival_flows import Flow
from skystack.simulator.arrivals import FREE, Arrivals, Candidates
from skystack.simulator.generator import Scenarios
from skystack.simulator.traffic import Traffic


@dataclass(frozen=True)
class DrawnFlow(Flow):
    """The flights of a scenario in the first slots. Its `clock` must have a rate of zero.

    `slots` must not be less than the number of aircraft.
    """

    scenarios: Scenarios = field(kw_only=True)
    names: tuple[str, ...] = ()
    """The callsigns of the aircraft; empty if they have none of their own."""

    @property
    def callsigns(self) -> tuple[str, ...]:
        return self.names

    def draw(self, key: PRNGKeyArray) -> tuple[Arrivals, Traffic]:
        """The scenario that `scenarios` draws with the key."""
        arrivals, empty = super().draw(key)
        drawn, count = self.scenarios.draw(key), self.scenarios.aircraft
        ones = jnp.ones(count)
        there = drawn.traffic._replace(
            cleared_fix=drawn.traffic.next_fix, airspeed_factor=ones, climb_factor=ones
        )
        number = jnp.arange(self.slots, dtype=jnp.int32)
        flight = jnp.where(number < count, number, FREE)
        level = jnp.zeros(self.slots)
        born = jnp.full((), count, dtype=jnp.int32)
        arrivals = arrivals._replace(
            flight=flight,
            candidate=flight,
            entry_level_ticks=level.at[:count].set(there.level_ticks),
            exit_level_ticks=level.at[:count].set(drawn.exit_level_ticks),
            used=born,
            born=born,
        )
        traffic: Traffic = jax.tree.map(lambda all_, some: all_.at[:count].set(some), empty, there)
        return arrivals, traffic

    def _candidates(self, key: PRNGKeyArray) -> Candidates:
        """A candidate that is never used: there is no arrival."""
        zero: Any = jnp.zeros(1)
        return Candidates(
            due_s=zero,
            route=jnp.zeros(1, dtype=jnp.int32),
            position_nm=jnp.zeros((1, 2)),
            heading_deg=zero,
            entry_level_ticks=zero,
            exit_level_ticks=zero,
            airspeed_factor=zero + 1.0,
            climb_factor=zero + 1.0,
        )
