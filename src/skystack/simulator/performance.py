"""Performance models: the airspeed and the vertical speed of aircraft.

A model computes both for arrays of levels and flight phases. Each of the two models here agrees
with one of BluebirdDT's predictors. Speeds change immediately with the phase: acceleration is not
modelled.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from skystack.errors import unknown_name

TICKS_PER_FL = 6000.0
"""One tick is the height gained in one second at 1 ft/min. Rates in ft/min are whole ticks per
second, so levels are exact in float32 (up to FL2796) and do not drift."""

DEFAULT_TYPE = "B753"
"""The type with the default speeds, which are those of BluebirdDT's MEDIUM class."""


@runtime_checkable
class Performance(Protocol):
    """Speeds and rates as functions of level [ticks] and phase (1 climb, 0 level, -1 descent).

    With several types of aircraft, `kind` is the index of each aircraft's type; see
    `skystack.simulator.fleet`.
    """

    @property
    def types(self) -> tuple[str, ...]:
        """The ICAO type designators. `kind` is an index into them."""

    @property
    def route_end_nm(self) -> float:
        """The distance [NM] from a route's last fix at which own navigation ends."""

    def cruise_kt(self, fl: Float[np.ndarray, " levels"]) -> Float[np.ndarray, "types levels"]:
        """True airspeed of each type in level flight at flight levels. In numpy, for planning."""

    def true_airspeed_kt(
        self,
        level_ticks: Float[Array, "*n"],
        phase: Float[Array, "*n"],
        kind: Int[Array, "*n"] | None = None,
    ) -> Float[Array, "*n"]: ...

    def vertical_speed_ft_min(
        self,
        level_ticks: Float[Array, "*n"],
        phase: Float[Array, "*n"],
        kind: Int[Array, "*n"] | None = None,
    ) -> Float[Array, "*n"]:
        """The signed rate, which equals the ticks gained per second."""


@dataclass(frozen=True)
class ConstantPerformance:
    """The same true airspeed at all levels, and one rate of climb and descent."""

    airspeed_kt: float = 400.0
    rate_ft_min: float = 2000.0
    route_end_nm: float = 2.0
    types: tuple[str, ...] = (DEFAULT_TYPE,)

    def cruise_kt(self, fl: Float[np.ndarray, " levels"]) -> Float[np.ndarray, "types levels"]:
        return np.full((1, len(fl)), self.airspeed_kt)

    def true_airspeed_kt(
        self,
        level_ticks: Float[Array, "*n"],
        phase: Float[Array, "*n"],
        kind: Int[Array, "*n"] | None = None,
    ) -> Float[Array, "*n"]:
        return jnp.full_like(level_ticks, self.airspeed_kt)

    def vertical_speed_ft_min(
        self,
        level_ticks: Float[Array, "*n"],
        phase: Float[Array, "*n"],
        kind: Int[Array, "*n"] | None = None,
    ) -> Float[Array, "*n"]:
        return phase * self.rate_ft_min


@dataclass(frozen=True)
class TablePerformance:
    """Calibrated airspeeds and Mach numbers by level and phase in the standard atmosphere.

    The defaults are BluebirdDT's MEDIUM class, which includes the B753: 465.94 kt in cruise at
    FL300. Tuples are (climb, cruise, descent). Calibrated airspeed is interpolated between FL100
    and FL150.
    """

    low_cas_kt: tuple[float, float, float] = (250.0, 250.0, 250.0)
    """Calibrated airspeed up to FL100."""
    high_cas_kt: tuple[float, float, float] = (290.0, 300.0, 280.0)
    """Calibrated airspeed from FL150."""
    mach: tuple[float, float, float] = (0.79, 0.80, 0.78)
    """Maximum Mach number."""
    rate_ft_min: float = 2500.0
    ceiling_fl: float = 400.0
    """Aircraft at or above this level do not climb."""
    route_end_nm: float = 0.5
    types: tuple[str, ...] = (DEFAULT_TYPE,)

    @cached_property
    def airspeeds_kt(self) -> Float[np.ndarray, "3 levels"]:
        """True airspeed at each flight level from 0 to 600, for climb, cruise and descent."""
        fl = np.arange(601.0)
        return np.array(
            [
                np.minimum(tas_from_cas(fl, self.cas_kt(fl, phase)), tas_from_mach(fl, mach))
                for phase, mach in enumerate(self.mach)
            ]
        )

    def cas_kt(self, fl: Float[np.ndarray, "*n"], phase: int) -> Float[np.ndarray, "*n"]:
        """Calibrated airspeed below the crossover level. Phases: 0 climb, 1 cruise, 2 descent."""
        return np.interp(fl, [100.0, 150.0], [self.low_cas_kt[phase], self.high_cas_kt[phase]])

    def cruise_kt(self, fl: Float[np.ndarray, " levels"]) -> Float[np.ndarray, "types levels"]:
        cruise = self.airspeeds_kt[1]
        return np.interp(fl, np.arange(len(cruise)), cruise)[None]

    def true_airspeed_kt(
        self,
        level_ticks: Float[Array, "*n"],
        phase: Float[Array, "*n"],
        kind: Int[Array, "*n"] | None = None,
    ) -> Float[Array, "*n"]:
        table = jnp.asarray(self.airspeeds_kt.reshape(-1), dtype=jnp.float32)
        levels = self.airspeeds_kt.shape[1]
        fl = jnp.clip(level_ticks / TICKS_PER_FL, 0.0, levels - 1.001)
        below = jnp.floor(fl)
        row = (below + levels * (1.0 - phase)).astype(jnp.int32)
        return table[row] + (fl - below) * (table[row + 1] - table[row])

    def vertical_speed_ft_min(
        self,
        level_ticks: Float[Array, "*n"],
        phase: Float[Array, "*n"],
        kind: Int[Array, "*n"] | None = None,
    ) -> Float[Array, "*n"]:
        at_ceiling = (phase > 0.0) & (level_ticks >= self.ceiling_fl * TICKS_PER_FL)
        return jnp.where(at_ceiling, 0.0, phase * self.rate_ft_min)


PERFORMANCE: dict[str, Performance] = {
    "table": TablePerformance(),
    "constant": ConstantPerformance(),
}


def performance(name: str) -> Performance:
    """The performance model with the given name. Raises InputError if it is unknown."""
    if name not in PERFORMANCE:
        raise unknown_name("performance model", name, PERFORMANCE)
    return PERFORMANCE[name]


# The ICAO standard atmosphere (Doc 7488): troposphere and lower stratosphere.
_SEA_LEVEL_K, _SEA_LEVEL_PA, _SEA_LEVEL_KG_M3 = 288.15, 101325.0, 1.225
_LAPSE_K_M, _TROPOPAUSE_M, _G_M_S2, _GAS_J_KG_K, _HEAT_RATIO = (
    0.0065,
    11000.0,
    9.80665,
    287.05287,
    1.4,
)
_M_PER_FL, _KT_PER_M_S = 30.48, 3600.0 / 1852.0


def _atmosphere(
    fl: Float[np.ndarray, "*n"],
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """Temperature [K] and pressure [Pa] of the standard atmosphere."""
    height = fl * _M_PER_FL
    temperature = _SEA_LEVEL_K - _LAPSE_K_M * np.minimum(height, _TROPOPAUSE_M)
    pressure = _SEA_LEVEL_PA * (temperature / _SEA_LEVEL_K) ** (
        _G_M_S2 / (_LAPSE_K_M * _GAS_J_KG_K)
    )
    above = np.maximum(height - _TROPOPAUSE_M, 0.0)
    return temperature, pressure * np.exp(-_G_M_S2 * above / (_GAS_J_KG_K * temperature))


def tas_from_cas(
    fl: Float[np.ndarray, "*n"], cas_kt: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """True airspeed [kt] for a calibrated airspeed [kt] in the standard atmosphere.

    Uses the equations of compressible flow.
    """
    temperature, pressure = _atmosphere(fl)
    power = (_HEAT_RATIO - 1.0) / _HEAT_RATIO
    cas = cas_kt / _KT_PER_M_S
    impact = (1.0 + 0.5 * power * _SEA_LEVEL_KG_M3 / _SEA_LEVEL_PA * cas**2) ** (1.0 / power) - 1.0
    density = pressure / (_GAS_J_KG_K * temperature)
    ratio = (1.0 + _SEA_LEVEL_PA / pressure * impact) ** power - 1.0
    return np.sqrt(2.0 / power * pressure / density * ratio) * _KT_PER_M_S


def tas_from_mach(fl: Float[np.ndarray, "*n"], mach: float) -> Float[np.ndarray, "*n"]:
    """True airspeed [kt] for a Mach number in the standard atmosphere."""
    temperature, _ = _atmosphere(fl)
    return mach * np.sqrt(_HEAT_RATIO * _GAS_J_KG_K * temperature) * _KT_PER_M_S
