"""A task made by hand, compiled in no time: whatever an environment makes of it is a formula."""

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

    Observed are the scenario's number, the cycles flown and the actions given, in hundredths. Of
    two agents, the second gets a quarter of the reward, and its part ends in the first cycle.
    """

    truncates: bool = False
    """Whether the end is a truncation."""
    agents: int = 1

    name, version = "counting", 1
    action_names = ("none", "one", "two")
    observation_names = ("drawn", "cycles", "told")
    metrics = MappingProxyType(
        {
            "success": Metric("true or false", "an action was given"),
            "few_instructions": Metric("true or false", "the sum of all actions is below 3"),
            "instructions": Metric("count", "the sum of all actions"),
            "drawn": Metric("number", "the scenario's number"),
            "cycles": Metric("count", "cycles flown"),
        }
    )

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
        metrics = {
            "success": state.told > 0.0,
            "few_instructions": state.told < 3.0,
            "instructions": state.told,
            "drawn": state.drawn,
            "cycles": cycles,
        }
        reward = cycles + 10.0 * state.waiting
        rewards = jnp.stack([reward] if self.agents == 1 else [0.75 * reward, 0.25 * reward])
        ends = jnp.stack([ended, jnp.ones_like(ended)][: self.agents])
        never = jnp.zeros_like(ends)
        terminated, truncated = (never, ends) if self.truncates else (ends, never)
        outcome = Outcome(rewards, terminated, truncated, ended, metrics)
        return state._replace(cycles=cycles, waiting=jnp.zeros_like(cycles)), outcome

    def step(self, state, action):
        return self.advance(self.instruct(state, action))


@dataclass(frozen=True)
class Structured(Counting):
    """The same with observations of named parts, in the same order once flattened."""

    def observe(self, state):
        drawn, *others = super().observe(state)
        return {"b": jnp.stack(others), "a": drawn[None]}


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
