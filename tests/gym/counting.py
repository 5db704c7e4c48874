"""A trivial task that compiles quickly and whose outcomes are known in closed form."""

from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from skystack.airspace.xplus import x_plus
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import start
from skystack.tasks.contract import Metric, Outcome

SHORTEST, LONGEST = 2, 4


class Counted(NamedTuple):
    drawn: jax.Array
    """The scenario's random number in [0, 1)."""
    cycles: jax.Array
    total: jax.Array
    """The sum of all actions."""
    pending: jax.Array
    """The sum of the actions since the last cycle."""


def length_of(drawn):
    """The number of cycles until a scenario ends, from its random number."""
    return SHORTEST + np.floor(np.asarray(drawn) * (LONGEST + 1 - SHORTEST)).astype(int)


@dataclass(frozen=True)
class Counting:
    """Scenarios of 2 to 4 cycles. The reward is the cycle's number plus ten times its actions.

    The observation is the scenario's random number, and the cycles and the sum of all actions, both
    divided by 100. Of two agents, the second gets a quarter of the reward and ends after one cycle.
    """

    truncates: bool = False
    """Whether the end is a truncation."""
    agents: int = 1

    name, version = "counting", 1
    action_names = ("none", "one", "two")
    observation_names = ("drawn", "cycles", "total")
    metrics = MappingProxyType(
        {
            "success": Metric("true or false", "an instruction was issued"),
            "few_instructions": Metric("true or false", "the sum of all actions is below 3"),
            "instructions": Metric("count", "the sum of all actions"),
            "drawn": Metric("number", "the scenario's random number"),
            "cycles": Metric("count", "cycles flown"),
        }
    )

    def reset(self, key):
        return Counted(jax.random.uniform(key), *(jnp.zeros(()) for _ in range(3)))

    def observe(self, state):
        return jnp.stack([state.drawn, state.cycles / 100.0, state.total / 100.0])

    def may_stack(self, state, action):
        return (action > 0) & (state.pending < 4.0)

    def instruct(self, state, action):
        amount = action.astype(jnp.float32)
        return state._replace(total=state.total + amount, pending=state.pending + amount)

    def advance(self, state):
        cycles = state.cycles + 1.0
        span = LONGEST + 1.0 - SHORTEST
        ended = cycles >= SHORTEST + jnp.floor(state.drawn * span)
        metrics = {
            "success": state.total > 0.0,
            "few_instructions": state.total < 3.0,
            "instructions": state.total,
            "drawn": state.drawn,
            "cycles": cycles,
        }
        reward = cycles + 10.0 * state.pending
        rewards = jnp.stack([reward] if self.agents == 1 else [0.75 * reward, 0.25 * reward])
        ends = jnp.stack([ended, jnp.ones_like(ended)][: self.agents])
        never = jnp.zeros_like(ends)
        terminated, truncated = (never, ends) if self.truncates else (ends, never)
        outcome = Outcome(rewards, terminated, truncated, ended, metrics)
        return state._replace(cycles=cycles, pending=jnp.zeros_like(cycles)), outcome

    def step(self, state, action):
        return self.advance(self.instruct(state, action))


@dataclass(frozen=True)
class Structured(Counting):
    """The same with a dictionary as observation; flattened, it has the same order."""

    def observe(self, state):
        drawn, *others = super().observe(state)
        return {"b": jnp.stack(others), "a": drawn[None]}


@dataclass(frozen=True)
class Visible(Counting):
    """The same with three visible aircraft, all with different values; the third has left.

    In each cycle, the first flies one mile east and the second one mile west.
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
