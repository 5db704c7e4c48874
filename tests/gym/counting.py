"""A task made by hand, compiled in no time: whatever an environment makes of it is a formula."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from skystack.airspace.xplus import x_plus
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import start
from skystack.tasks.contract import Metrics, Outcome

SHORTEST, LONGEST = 2, 4


class Counted(NamedTuple):
    drawn: jax.Array
    """In [0, 1): the scenario's number."""
    cycles: jax.Array
    told: jax.Array
    """The sum of all actions."""
    waiting: jax.Array
    """That of the actions since the last cycle."""


def length_of(drawn):
    """Cycles until the scenario ends, by its number."""
    return SHORTEST + np.floor(np.asarray(drawn) * (LONGEST + 1 - SHORTEST)).astype(int)


@dataclass(frozen=True)
class Counting:
    """Scenarios of 2 to 4 cycles. A cycle's reward is its number, and ten times what was said.

    Observed are the scenario's number, the cycles flown and the actions given, in hundredths.
    """

    truncates: bool = False
    """Whether the end is a truncation."""

    name, version = "counting", 1
    action_names = ("none", "one", "two")
    observation_names = ("drawn", "cycles", "told")

    def reset(self, key):
        return Counted(jax.random.uniform(key), *(jnp.zeros(()) for _ in range(3)))

    def observe(self, state):
        return jnp.stack([state.drawn, state.cycles / 100.0, state.told / 100.0])

    def may_stack(self, state, action):
        return (action > 0) & (state.waiting < 4.0)

    def instruct(self, state, action):
        said = action.astype(jnp.float32)
        return state._replace(told=state.told + said, waiting=state.waiting + said)

    def advance(self, state):
        cycles = state.cycles + 1.0
        span = LONGEST + 1.0 - SHORTEST
        ended = cycles >= SHORTEST + jnp.floor(state.drawn * span)
        metrics = Metrics(
            success=state.told > 0.0,
            correct_exit=ended,
            excursion=state.told == 0.0,
            few_instructions=state.told < 3.0,
            instructions=state.told,
            bursts=10.0 * state.drawn,
            min_separation_nm=state.drawn,
            cycles=cycles,
        )
        never = jnp.zeros_like(ended)
        ends = (never, ended) if self.truncates else (ended, never)
        outcome = Outcome(cycles + 10.0 * state.waiting, *ends, metrics)
        return state._replace(cycles=cycles, waiting=jnp.zeros_like(cycles)), outcome

    def step(self, state, action):
        return self.advance(self.instruct(state, action))


@dataclass(frozen=True)
class Visible(Counting):
    """The same with three aircraft to be seen, each with figures of its own; the third has left.

    Each cycle takes the first a mile to the east and the second a mile to the west.
    """

    @property
    def sector(self):
        return x_plus()

    def traffic(self, state):
        east = float(state.cycles)
        fl, cleared_fl = jnp.array([[290.0, 310.0, 330.0], [300.0, 280.0, 330.0]])
        traffic = start(
            position_nm=jnp.array([[east, 10.0], [-east, -20.0], [5.0, 5.0]]),
            heading_deg=jnp.array([90.0, 270.0, 0.0]),
            level_ticks=fl * TICKS_PER_FL,
            route=jnp.array([3, 1, 2]),
            ground_speed_kt=jnp.array([420.0, 480.0, 500.0]),
            own_navigation=jnp.zeros(3, dtype=bool),
        )
        return traffic._replace(
            cleared_heading_deg=jnp.array([120.0, 200.0, 0.0]),
            cleared_level_ticks=cleared_fl * TICKS_PER_FL,
            active=jnp.array([True, True, False]),
        )
