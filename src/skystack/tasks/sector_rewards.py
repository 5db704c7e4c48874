"""The rewards of sector control. Each flight is paid for what happens to it.

A term's function returns what is paid per unit of its weight, `[slots, *batch]`. Costs are
negative. The terms `level` and `route` are differences of a potential, so over a whole flight they
depend only on how it began and ended.
"""

from collections.abc import Callable
from typing import Annotated, NamedTuple

import jax.numpy as jnp
import msgspec
from jaxtyping import Array, Bool, Float

from skystack.simulator.traffic import ticks

FAIL_SAFE_S = 300.0
"""A cycle is fail-safe if no flight would lose separation within this time without a clearance."""

PerFlight = Float[Array, "slots *batch"]
Flags = Bool[Array, "slots *batch"]


class FlightCycle(NamedTuple):
    """What happened to each flight in a cycle."""

    transmission: Flags
    """Whether a transmission to it began."""
    instructions: PerFlight
    """The number of instructions to it."""
    time_to_loss_s: PerFlight
    """The predicted time until it loses separation, as cleared, after the cycle."""
    loss: Flags
    """Whether it lost separation, and had it before."""
    excursion: Flags
    exited: Flags
    level_error_ticks: PerFlight
    """The distance from its exit level."""
    nearer_level_ticks: PerFlight
    """By how much its cleared level came nearer to its exit level."""
    nearer_exit_nm: PerFlight
    """By how much it came nearer to its exit."""


class SectorReward(NamedTuple):
    """A reward term: its function, its default weight and its description."""

    value: Callable[[FlightCycle], PerFlight]
    default: float
    description: str


def _number(flag: Flags) -> PerFlight:
    return flag.astype(jnp.float32)


def predicted_loss(cycle: FlightCycle) -> PerFlight:
    """-1 for a loss of separation now, rising to 0 for one in five minutes."""
    return -jnp.maximum(1.0 - cycle.time_to_loss_s / FAIL_SAFE_S, 0.0)


def wrong_level(cycle: FlightCycle) -> PerFlight:
    """-1 for an exit at another level, and -1 more for every 100 flight levels of error."""
    wrong = cycle.exited & (cycle.level_error_ticks > 0.0)
    return -_number(wrong) * (1.0 + cycle.level_error_ticks / ticks(100.0))


SECTOR_REWARDS: dict[str, SectorReward] = {
    "transmission": SectorReward(
        lambda cycle: -_number(cycle.transmission), 1.0, "a transmission begins: -1"
    ),
    "instruction": SectorReward(lambda cycle: -cycle.instructions, 0.05, "an instruction: -1"),
    "predicted": SectorReward(
        predicted_loss,
        0.5,
        "predicted loss of separation, as cleared: -1 if now, rising to 0 in five minutes",
    ),
    "loss": SectorReward(lambda cycle: -_number(cycle.loss), 50.0, "separation is lost: -1"),
    "excursion": SectorReward(
        lambda cycle: -_number(cycle.excursion),
        50.0,
        "the flight leaves other than through its exit: -1",
    ),
    "wrong_level": SectorReward(
        wrong_level,
        20.0,
        "it exits at a wrong level: -1, and a further -1 per 100 flight levels of error",
    ),
    "exit": SectorReward(
        lambda cycle: _number(cycle.exited & (cycle.level_error_ticks == 0.0)),
        5.0,
        "it leaves through its exit at its exit level: 1",
    ),
    "level": SectorReward(
        lambda cycle: cycle.nearer_level_ticks / ticks(100.0),
        3.0,
        "its cleared level comes nearer to its exit level: 1 per 100 flight levels",
    ),
    "route": SectorReward(
        lambda cycle: cycle.nearer_exit_nm / 100.0, 3.0, "it comes nearer to its exit: 1 per 100 NM"
    ),
    "delay": SectorReward(
        lambda cycle: -jnp.ones_like(cycle.nearer_exit_nm), 0.02, "a cycle of flight: -1"
    ),
}
"""The reward terms by name."""

_WEIGHT = msgspec.Meta(ge=0.0, le=1e4)

SectorRewardSettings = msgspec.defstruct(
    "SectorRewardSettings",
    [(name, Annotated[float, _WEIGHT], each.default) for name, each in SECTOR_REWARDS.items()],
    module=__name__,
    frozen=True,
    forbid_unknown_fields=True,
    namespace={"__doc__": "The weights of `SECTOR_REWARDS`."},
)


def total_reward(weights: msgspec.Struct, cycle: FlightCycle) -> PerFlight:
    """The weighted sum of all terms."""
    total = jnp.zeros_like(cycle.nearer_exit_nm)
    for name, term in SECTOR_REWARDS.items():
        weight = getattr(weights, name)
        if weight:
            total += weight * term.value(cycle)
    return total
