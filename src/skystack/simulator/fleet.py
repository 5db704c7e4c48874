"""Aircraft of several types in one scenario: each flies by a table of its own."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import jax.numpy as jnp
import msgspec
import numpy as np
from jaxtyping import Array, Float, Int
from msgspec import Meta

from skystack.errors import InputError
from skystack.simulator.performance import DEFAULT_TYPE, TablePerformance

_MEDIUM = TablePerformance()

Airspeed = Annotated[float, Meta(ge=80.0, le=400.0)]
Mach = Annotated[float, Meta(ge=0.2, le=0.95)]


class AircraftType(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of a fleet: how fast a type flies, and how often it comes in random scenarios.

    Triples are climb, cruise, descent; what is left out is as of the B753.
    """

    type: Annotated[str, Meta(pattern=r"^[A-Z0-9]{2,4}$")] = DEFAULT_TYPE
    """ICAO designator; what other simulators fly it as."""
    share: Annotated[float, Meta(gt=0.0, le=1e6)] = 1.0
    """How often, relative to the other entries."""
    low_cas_kt: tuple[Airspeed, Airspeed, Airspeed] = _MEDIUM.low_cas_kt
    """Calibrated airspeed up to FL100."""
    high_cas_kt: tuple[Airspeed, Airspeed, Airspeed] = _MEDIUM.high_cas_kt
    """From FL150."""
    mach: tuple[Mach, Mach, Mach] = _MEDIUM.mach
    """Not exceeded."""
    rate_ft_min: Annotated[float, Meta(ge=100.0, le=8000.0)] = _MEDIUM.rate_ft_min
    """Of climb and descent."""
    ceiling_fl: Annotated[float, Meta(ge=0.0, le=600.0)] = _MEDIUM.ceiling_fl
    """At or above it nothing climbs."""

    def table(self) -> TablePerformance:
        return TablePerformance(
            self.low_cas_kt, self.high_cas_kt, self.mach, self.rate_ft_min, self.ceiling_fl
        )


@dataclass(frozen=True)
class Fleet:
    """Implements `skystack.simulator.performance.Performance`; a kind is an index of `members`."""

    members: tuple[AircraftType, ...]

    @cached_property
    def tables(self) -> tuple[TablePerformance, ...]:
        """One a member; each computes its airspeeds once, whatever asks for them."""
        return tuple(member.table() for member in self.members)

    @property
    def types(self) -> tuple[str, ...]:
        return tuple(member.type for member in self.members)

    @property
    def route_end_nm(self) -> float:
        return _MEDIUM.route_end_nm

    def cruise_kt(self, fl: Float[np.ndarray, " levels"]) -> Float[np.ndarray, "types levels"]:
        return np.concatenate([each.cruise_kt(fl) for each in self.tables])

    def true_airspeed_kt(
        self,
        level_ticks: Float[Array, "*n"],
        phase: Float[Array, "*n"],
        kind: Int[Array, "*n"] | None = None,
    ) -> Float[Array, "*n"]:
        return self._of(kind, [each.true_airspeed_kt(level_ticks, phase) for each in self.tables])

    def vertical_speed_ft_min(
        self,
        level_ticks: Float[Array, "*n"],
        phase: Float[Array, "*n"],
        kind: Int[Array, "*n"] | None = None,
    ) -> Float[Array, "*n"]:
        return self._of(
            kind, [each.vertical_speed_ft_min(level_ticks, phase) for each in self.tables]
        )

    def _of(
        self, kind: Int[Array, "*n"] | None, values: list[Float[Array, "*n"]]
    ) -> Float[Array, "*n"]:
        """Of the values of every member, each aircraft's own; the first's where none is said."""
        value = values[0]
        if kind is not None:
            for number, other in enumerate(values[1:], start=1):
                value = jnp.where(kind == number, other, value)
        return value


MOST_TYPES = 20
"""In a fleet."""


def fleet(members: tuple[AircraftType, ...], where: str = "task.fleet") -> Fleet:
    """A fleet. Raises InputError, which names the field `where`, for a type that comes twice."""
    types = [member.type for member in members]
    for number, name in enumerate(types):
        if name in types[:number]:
            raise InputError(f"{where}[{number}].type is {name} (allowed: every type once)")
    return Fleet(members)
