"""Random draws for entering aircraft: routes, levels and types."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.airspace.sector import Sector
from skystack.simulator.traffic import ticks

_LEVELS, _KINDS = 1, 2
"""Folded into the key, so that drawing levels and types does not change the other draws."""


def draw_routes_apart(
    key: PRNGKeyArray, sector: Sector, aircraft: int
) -> Int[Array, " {aircraft}"]:
    """A route for each aircraft, all with different first fixes.

    Routes are drawn in order, each uniformly from those whose first fix is not yet used.
    """
    same_start = jnp.asarray(_same_start(sector))
    free = jnp.ones(same_start.shape[0], dtype=bool)
    routes = []
    for uniforms in jax.random.uniform(key, (aircraft, same_start.shape[0])):
        routes.append(jnp.argmax(jnp.where(free, uniforms, -1.0)).astype(jnp.int32))
        free = free & ~same_start[routes[-1]]
    return jnp.stack(routes)


def _same_start(sector: Sector) -> Bool[np.ndarray, "routes routes"]:
    first = np.array([route[0] for route in sector.routes])
    return first[:, None] == first[None, :]


def first_fixes(sector: Sector) -> int:
    """The number of different first fixes of a sector's routes.

    This is the maximum number of aircraft for `draw_routes_apart`.
    """
    return len({route[0] for route in sector.routes})


def draw_levels(
    key: PRNGKeyArray, levels_fl: tuple[int, ...], aircraft: int
) -> Float[Array, " {aircraft}"]:
    """A level for each aircraft, drawn uniformly from those given; in ticks."""
    levels = jnp.array([ticks(float(fl)) for fl in levels_fl], dtype=jnp.float32)
    if len(levels_fl) == 1:
        return jnp.full(aircraft, levels[0])
    return jax.random.choice(jax.random.fold_in(key, _LEVELS), levels, (aircraft,))


def draw_kinds(
    key: PRNGKeyArray, shares: tuple[float, ...], aircraft: int
) -> Int[Array, " {aircraft}"]:
    """A type for each aircraft, drawn in proportion to the shares.

    Types are indices into the types of the performance model.
    """
    if len(shares) == 1:
        return jnp.zeros(aircraft, dtype=jnp.int32)
    weights = jnp.log(jnp.array(shares, dtype=jnp.float32))
    drawn = jax.random.categorical(jax.random.fold_in(key, _KINDS), weights, shape=(aircraft,))
    return drawn.astype(jnp.int32)
