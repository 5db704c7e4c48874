"""The rewards of the paper's section "Reward", each a function of arrays over aircraft.

Weights and the sum are in `navigation.py`; a term of our own says so.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

CENTRELINE_SCALE_NM = 6.0
SAFETY_SCALE_NM = 5.0
VERTICAL_SCALE_FL = 40.0
DAMPING_CYCLES = 10.0
"""n_max: cycles after an instruction in which damping still costs."""
CRITERION_BONUS = 5.0
SUCCESS_BONUS = 20.0
MAX_INSTRUCTIONS = 30.0
"""Fewer than this per aircraft satisfies the count criterion."""


def centreline(distance_nm: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Equation (centreline): exp(-(d_c / 6)^2) - 1."""
    return jnp.exp(-((distance_nm / CENTRELINE_SCALE_NM) ** 2)) - 1.0


def damping(cycles_since_instruction: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Equation (sparse_action): n_s / n_max - 1 below n_max = 10, else 0."""
    return jnp.minimum(cycles_since_instruction / DAMPING_CYCLES - 1.0, 0.0)


def safety(
    distance_nm: Float[Array, "*n"], closest_nm: Float[Array, "*n"], range_nm: float
) -> Float[Array, "*n"]:
    """Equation (eq:safety_reward): (d_12 / d_max - 1) exp(-(d_s / 5)^2) below d_max, else 0."""
    urgency = jnp.minimum(distance_nm / range_nm - 1.0, 0.0)
    return urgency * jnp.exp(-((closest_nm / SAFETY_SCALE_NM) ** 2))


def vertical(cleared_minus_exit_fl: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Equation (eq:vertical_reward): exp(-abs(dFL) / 40) - 1."""
    return jnp.exp(-jnp.abs(cleared_minus_exit_fl) / VERTICAL_SCALE_FL) - 1.0


def outside_band(distance_nm: Float[Array, "*n"], band_nm: float) -> Float[Array, "*n"]:
    """How far from the centreline beyond a band in which deviating costs nothing (ours) [NM]."""
    return jnp.maximum(jnp.abs(distance_nm) - band_nm, 0.0)


def terminal(criteria: Bool[Array, "criteria aircraft *batch"]) -> Float[Array, "*batch"]:
    """The terminal reward set: 5 a criterion, averaged over aircraft; 20 if all are satisfied."""
    each = CRITERION_BONUS * jnp.sum(jnp.mean(criteria.astype(jnp.float32), axis=1), axis=0)
    return each + jnp.where(jnp.all(criteria, axis=(0, 1)), SUCCESS_BONUS, 0.0)
