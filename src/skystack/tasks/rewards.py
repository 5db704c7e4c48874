"""The registry of reward terms, `REWARDS`, with the default weight and parameters of each.

Settings, model cards and documentation read `REWARDS`. The formulas are from the paper's section
"Reward". `leg` and `shared_damping` are other readings of it; `outside_band`, `excursion`, `burst`
and `conflict` are not in the paper. `total` adds the terms up.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from skystack.airspace.sector import Sector
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import Traffic
from skystack.tasks.centreline import distance_from_leg, distance_from_route
from skystack.tasks.instruction_counts import DAMPING_CYCLES
from skystack.tasks.pairs import RANGE_NM, pairs_of
from skystack.tasks.tracking import Memory

CENTRELINE_SCALE_NM = 6.0
SAFETY_SCALE_NM = 5.0
VERTICAL_SCALE_FL = 40.0
CRITERION_BONUS = 5.0
SUCCESS_BONUS = 20.0
MAX_INSTRUCTIONS = 30.0
"""Fewer instructions than this per aircraft satisfy the count criterion."""
MAX_WEIGHT = 1000.0


@dataclass(frozen=True)
class Cycle:
    """The inputs of the reward of one cycle."""

    sector: Sector
    weights: Any
    """A `skystack.tasks.settings.RewardSettings`, which also contains the parameters."""
    before: Memory
    """The memory before the cycle."""
    memory: Memory
    """The memory after the cycle."""
    flown: Traffic
    """The traffic after the cycle, with `active` as before the cycle."""

    @cached_property
    def distance_nm(self) -> Float[Array, "aircraft *batch"]:
        """The distance of each aircraft from the centreline of its route, positive to the right."""
        return distance_from_route(self.sector, self.flown)

    @cached_property
    def criteria(self) -> Bool[Array, "criteria aircraft *batch"]:
        """Whether each aircraft satisfies each criterion of success."""
        progress = self.memory.progress
        criteria = [progress.exited_correctly, ~progress.excursion]
        if self.weights.count_criterion:
            criteria.append(self.memory.counts.instructions < MAX_INSTRUCTIONS)
        return jnp.stack(criteria)


class Parameter(NamedTuple):
    """A parameter of a term besides its weight: a number in a range, or a boolean."""

    default: float | bool
    description: str
    low: float = 0.0
    high: float = 100.0


class Reward(NamedTuple):
    """A term of the reward."""

    value: Callable[[Cycle], Array]
    """The reward with a weight of 1: `[aircraft, *batch]`, or `[*batch]` for the scenario."""
    paid: Literal["aircraft", "scenario", "end"]
    """When the term is paid: every cycle for each active aircraft, averaged over all aircraft;
    every cycle for the scenario; or at the end of the scenario."""
    default: float
    """The default weight."""
    unit: str
    """How often the weight is paid: `each cycle`, `once`, ..."""
    description: str
    parameters: dict[str, Parameter] = {}  # noqa: RUF012  (part of an immutable registry)


def centreline(distance_nm: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Equation (centreline): exp(-(d_c / 6)^2) - 1."""
    return jnp.exp(-((distance_nm / CENTRELINE_SCALE_NM) ** 2)) - 1.0


def damping(cycles_since_instruction: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Equation (sparse_action): n_s / n_max - 1 below n_max = 10, else 0."""
    return jnp.minimum(cycles_since_instruction / DAMPING_CYCLES - 1.0, 0.0)


def outside_band(distance_nm: Float[Array, "*n"], band_nm: float) -> Float[Array, "*n"]:
    """Minus the distance [NM] outside a band around the centreline."""
    return -jnp.maximum(jnp.abs(distance_nm) - band_nm, 0.0)


def vertical(cleared_minus_exit_fl: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Equation (eq:vertical_reward): exp(-abs(dFL) / 40) - 1."""
    return jnp.exp(-jnp.abs(cleared_minus_exit_fl) / VERTICAL_SCALE_FL) - 1.0


def safety(
    distance_nm: Float[Array, "*n"], closest_nm: Float[Array, "*n"], range_nm: float = RANGE_NM
) -> Float[Array, "*n"]:
    """Equation (eq:safety_reward): (d_12 / d_max - 1) exp(-(d_s / 5)^2) below d_max, else 0."""
    urgency = jnp.minimum(distance_nm / range_nm - 1.0, 0.0)
    return urgency * jnp.exp(-((closest_nm / SAFETY_SCALE_NM) ** 2))


def terminal(criteria: Bool[Array, "criteria aircraft *batch"]) -> Float[Array, "*batch"]:
    """The terminal reward set: 5 per criterion, averaged over aircraft, plus 20 if all are met."""
    each = CRITERION_BONUS * jnp.sum(jnp.mean(criteria.astype(jnp.float32), axis=1), axis=0)
    return each + jnp.where(jnp.all(criteria, axis=(0, 1)), SUCCESS_BONUS, 0.0)


def _shared_damping(cycle: Cycle) -> Float[Array, "*batch"]:
    """The damping reward with one counter for all aircraft, which any instruction resets."""
    waited = cycle.memory.counts.cycles_since_instruction
    return damping(jnp.min(jnp.where(cycle.flown.active, waited, DAMPING_CYCLES), axis=0))


def _new_excursion(cycle: Cycle) -> Float[Array, "aircraft *batch"]:
    """-1 in the cycle in which an excursion starts."""
    new = cycle.memory.progress.excursion & ~cycle.before.progress.excursion
    return -jnp.where(new, 1.0, 0.0)


def _level_gap_fl(cycle: Cycle) -> Float[Array, "aircraft *batch"]:
    gap = cycle.flown.cleared_level_ticks - cycle.memory.plan.exit_level_ticks
    return gap / TICKS_PER_FL


def _worst_pair(cycle: Cycle) -> Float[Array, "*batch"]:
    """The lowest safety reward of all pairs."""
    pairs = pairs_of(cycle.sector.plane, cycle.flown)
    each = safety(pairs.distance_nm, pairs.closest_nm)
    return jnp.min(jnp.where(pairs.active, each, 0.0), axis=0, initial=0.0)


def _too_close(cycle: Cycle) -> Float[Array, "*batch"]:
    """Minus the distance [NM] by which the least separation was below `conflict_nm`."""
    return -jnp.maximum(cycle.weights.conflict_nm - cycle.memory.separation.last_nm, 0.0)


REWARDS: dict[str, Reward] = {
    "centreline": Reward(
        lambda cycle: centreline(cycle.distance_nm),
        "aircraft",
        1.0,
        "each cycle",
        f"distance from the centreline: exp(-(NM / {CENTRELINE_SCALE_NM:g})²) - 1",
    ),
    "damping": Reward(
        lambda cycle: damping(cycle.memory.counts.cycles_since_instruction),
        "aircraft",
        0.25,
        "each cycle",
        f"after an instruction: rises from -1 to 0 within {DAMPING_CYCLES:g} cycles",
    ),
    "leg": Reward(
        lambda cycle: centreline(
            distance_from_leg(cycle.sector, cycle.flown, cycle.memory.progress.next_fix)
        ),
        "aircraft",
        0.0,
        "each cycle",
        f"distance from the leg to the next fix: exp(-(NM / {CENTRELINE_SCALE_NM:g})²) - 1",
    ),
    "shared_damping": Reward(
        _shared_damping,
        "scenario",
        0.0,
        "each cycle",
        f"after an instruction to any aircraft: from -1 to 0 within {DAMPING_CYCLES:g} cycles",
    ),
    "outside_band": Reward(
        lambda cycle: outside_band(cycle.distance_nm, cycle.weights.band_nm),
        "aircraft",
        0.0,
        "each cycle",
        "distance outside a band around the centreline: -1 per NM",
        {"band_nm": Parameter(0.0, "half the width of the band, NM")},
    ),
    "excursion": Reward(
        _new_excursion,
        "aircraft",
        0.0,
        "once",
        "leaving the sector other than through the exit, or never entering it: -1",
    ),
    "vertical": Reward(
        lambda cycle: vertical(_level_gap_fl(cycle)),
        "aircraft",
        0.0,
        "each cycle",
        f"difference from the exit level: exp(-FL / {VERTICAL_SCALE_FL:g}) - 1",
    ),
    "burst": Reward(
        lambda cycle: -cycle.before.counts.new_bursts,
        "scenario",
        0.0,
        "each",
        "a burst of instructions, which stacking compiles into one clearance: -1",
    ),
    "safety": Reward(
        _worst_pair,
        "scenario",
        0.0,
        "each cycle",
        f"predicted closest approach: -exp(-(NM / {SAFETY_SCALE_NM:g})²), reduced with distance",
    ),
    "conflict": Reward(
        _too_close,
        "scenario",
        0.0,
        "each cycle",
        "two aircraft closer than conflict_nm: -1 per NM",
        {"conflict_nm": Parameter(5.5, "the distance below which the term applies, NM")},
    ),
    "terminal": Reward(
        lambda cycle: terminal(cycle.criteria),
        "end",
        1.0,
        "once",
        f"at the end: {CRITERION_BONUS:g} per criterion, {SUCCESS_BONUS:g} if all are satisfied",
        {
            "count_criterion": Parameter(
                True,
                f"whether fewer than {MAX_INSTRUCTIONS:g} instructions per aircraft is a criterion",
            )
        },
    ),
}
"""The terms by name, in the order in which they are added up."""


def total(cycle: Cycle, ended: Bool[Array, "*batch"]) -> Float[Array, "*batch"]:
    """The weighted sum of all terms."""
    sums = {
        "aircraft": jnp.zeros_like(cycle.flown.level_ticks),
        "scenario": jnp.zeros_like(ended, dtype=jnp.float32),
        "end": jnp.zeros_like(ended, dtype=jnp.float32),
    }
    for name, reward in REWARDS.items():
        weight = getattr(cycle.weights, name)
        if weight:
            sums[reward.paid] += weight * reward.value(cycle)
    each = jnp.where(cycle.flown.active, sums["aircraft"], 0.0)
    at_end = jnp.where(ended, sums["end"], 0.0)
    return jnp.mean(each, axis=0) + sums["scenario"] + at_end
