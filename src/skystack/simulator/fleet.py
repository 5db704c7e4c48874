"""Fleets: several types of aircraft in one scenario, each with its own performance table."""

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
_DESIGNATOR = "text of 2 to 4 of A-Z and 0-9"

Airspeed = Annotated[float, Meta(ge=80.0, le=400.0)]
Mach = Annotated[float, Meta(ge=0.2, le=0.95)]


class AircraftType(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of a fleet: the performance of a type and its share of random traffic.

    Triples are climb, cruise, descent. The defaults are those of the B753.
    """

    type: Annotated[str, Meta(pattern=r"^[A-Z0-9]{2,4}\Z", description=_DESIGNATOR)] = DEFAULT_TYPE
    """ICAO type designator, also used on other platforms."""
    share: Annotated[float, Meta(gt=0.0, le=1e6)] = 1.0
    """Relative frequency in random scenarios."""
    low_cas_kt: tuple[Airspeed, Airspeed, Airspeed] = _MEDIUM.low_cas_kt
    """Calibrated airspeed up to FL100."""
    high_cas_kt: tuple[Airspeed, Airspeed, Airspeed] = _MEDIUM.high_cas_kt
    """Calibrated airspeed from FL150."""
    mach: tuple[Mach, Mach, Mach] = _MEDIUM.mach
    """Maximum Mach number."""
    rate_ft_min: Annotated[float, Meta(ge=100.0, le=8000.0)] = _MEDIUM.rate_ft_min
    """Rate of climb and descent."""
    ceiling_fl: Annotated[float, Meta(ge=0.0, le=600.0)] = _MEDIUM.ceiling_fl
    """Aircraft at or above this level do not climb."""

    def table(self) -> TablePerformance:
        return TablePerformance(
            self.low_cas_kt, self.high_cas_kt, self.mach, self.rate_ft_min, self.ceiling_fl
        )


@dataclass(frozen=True)
class Fleet:
    """Implements `skystack.simulator.performance.Performance`; `kind` is an index of `members`."""

    members: tuple[AircraftType, ...]

    @cached_property
    def tables(self) -> tuple[TablePerformance, ...]:
        """One table per member. Cached, because a table computes its airspeeds on first use."""
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
        return self._select(
            kind, [each.true_airspeed_kt(level_ticks, phase) for each in self.tables]
        )

    def vertical_speed_ft_min(
        self,
        level_ticks: Float[Array, "*n"],
        phase: Float[Array, "*n"],
        kind: Int[Array, "*n"] | None = None,
    ) -> Float[Array, "*n"]:
        return self._select(
            kind, [each.vertical_speed_ft_min(level_ticks, phase) for each in self.tables]
        )

    def _select(
        self, kind: Int[Array, "*n"] | None, values: list[Float[Array, "*n"]]
    ) -> Float[Array, "*n"]:
        """The value of each aircraft's type, or of the first type without `kind`."""
        value = values[0]
        if kind is not None:
            for number, other in enumerate(values[1:], start=1):
                value = jnp.where(kind == number, other, value)
        return value


def fleet(members: tuple[AircraftType, ...], where: str = "task.fleet") -> Fleet:
    """A fleet. Raises InputError, which names the field `where`, for a duplicate type."""
    types = [member.type for member in members]
    for number, name in enumerate(types):
        if name in types[:number]:
            raise InputError(f"{where}[{number}].type is {name} (allowed: every type once)")
    return Fleet(members)
