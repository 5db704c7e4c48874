"""Performance sampled from another simulator: speeds and rates of each type at whole levels."""

from dataclasses import dataclass
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from skystack.simulator.performance import TICKS_PER_FL, TablePerformance


@dataclass(frozen=True, eq=False)
class SampledPerformance:
    """Implements `skystack.simulator.performance.Performance`; `kind` is an index into the samples.

    Samples are at each flight level from 0, for climb, cruise and descent. Airspeeds are
    interpolated between levels. Rates are not: each applies up to the next sample.
    """

    types: tuple[str, ...]
    """The type of each kind. Kinds of the same type may differ."""
    airspeeds_kt: Float[np.ndarray, "kinds 3 levels"]
    """True airspeeds."""
    rates_ft_min: Float[np.ndarray, "kinds 3 levels"]
    """Signed vertical speeds."""

    @property
    def route_end_nm(self) -> float:
        return TablePerformance.route_end_nm

    @cached_property
    def _whole_rates(self) -> Float[np.ndarray, "kinds 3 levels"]:
        """Rates rounded to whole ticks per second, so that levels stay exact."""
        return np.rint(self.rates_ft_min)

    def cruise_kt(self, fl: Float[np.ndarray, " levels"]) -> Float[np.ndarray, "types levels"]:
        levels = np.arange(self.airspeeds_kt.shape[2])
        return np.array([np.interp(fl, levels, each[1]) for each in self.airspeeds_kt])

    def true_airspeed_kt(
        self,
        level_ticks: Float[Array, "*n"],
        phase: Float[Array, "*n"],
        kind: Int[Array, "*n"] | None = None,
    ) -> Float[Array, "*n"]:
        table = jnp.asarray(self.airspeeds_kt.reshape(-1), dtype=jnp.float32)
        row, above = self._row(level_ticks, phase, kind)
        return table[row] + above * (table[row + 1] - table[row])

    def vertical_speed_ft_min(
        self,
        level_ticks: Float[Array, "*n"],
        phase: Float[Array, "*n"],
        kind: Int[Array, "*n"] | None = None,
    ) -> Float[Array, "*n"]:
        table = jnp.asarray(self._whole_rates.reshape(-1), dtype=jnp.float32)
        return table[self._row(level_ticks, phase, kind)[0]]

    def _row(
        self, level_ticks: Float[Array, "*n"], phase: Float[Array, "*n"], kind: Array | None
    ) -> tuple[Int[Array, "*n"], Float[Array, "*n"]]:
        """The index of the sample at or below each level, and how far the level is above it."""
        levels = self.airspeeds_kt.shape[2]
        fl = jnp.clip(level_ticks / TICKS_PER_FL, 0.0, levels - 1.001)
        below = jnp.floor(fl)
        row = (below + levels * (1.0 - phase)).astype(jnp.int32)
        return (row if kind is None else row + kind * (3 * levels)), fl - below
