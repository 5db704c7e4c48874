"""Traffic of sector control for tests."""

import jax
import jax.numpy as jnp

from skystack.airspace.xplus import x_plus
from skystack.simulator.arrival_flows import Flow, constant_rate
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.tasks.sector_control import TO_FIX, SectorControl
from skystack.tasks.sector_kind import SectorSettings
from skystack.tasks.sector_rewards import SectorRewardSettings

SLOTS = 24
SIMULATOR = Simulator(x_plus(), performance("constant"), own_navigation=True)
TASK = SectorControl(
    Flow(SIMULATOR, constant_rate(90.0), slots=SLOTS, candidates=128),
    cycles=400,
    reward=SectorRewardSettings(),
)
RESET, STEP = jax.jit(TASK.reset), jax.jit(TASK.step)
OBSERVE, INSTRUCT, ADVANCE = jax.jit(TASK.observe), jax.jit(TASK.instruct), jax.jit(TASK.advance)
BEGIN, ALLOWED = jax.jit(TASK.begin), jax.jit(TASK.allowed)
"""Compiled once for all tests in a process; every new `jax.jit` would compile again."""
TELL, FLY = jax.jit(TASK.world.instruct), jax.jit(TASK.world.advance)
LOOK_AHEAD = jax.jit(TASK.world.look_ahead)
"""Programs of the task's world."""

SETTINGS = SectorSettings(slots=SLOTS, flights_per_hour=(100.0, 120.0), cycles=300, candidates=64)
"""Of the environments in tests; equal settings give programs that are compiled only once."""


def after(cycles, seed=0, action=TO_FIX):
    """The state after some cycles in which every flight is told the same."""
    state = RESET(jax.random.key(seed))
    actions = jnp.full(SLOTS, action, dtype=jnp.int32)
    for _ in range(cycles):
        state, _ = STEP(state, actions)
    return state
