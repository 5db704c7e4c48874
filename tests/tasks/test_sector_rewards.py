"""The rewards of sector control in closed form."""

import jax.numpy as jnp
import pytest

from skystack.simulator.traffic import ticks
from skystack.tasks.sector_rewards import (
    SECTOR_REWARDS,
    FlightCycle,
    SectorRewardSettings,
    total_reward,
)

NO, YES = jnp.zeros(1, dtype=bool), jnp.ones(1, dtype=bool)
QUIET = FlightCycle(
    transmission=NO,
    instructions=jnp.zeros(1),
    time_to_loss_s=jnp.full(1, jnp.inf),
    loss=NO,
    excursion=NO,
    exited=NO,
    level_error_ticks=jnp.zeros(1),
    nearer_level_ticks=jnp.zeros(1),
    nearer_exit_nm=jnp.zeros(1),
)


@pytest.mark.parametrize(
    ("term", "change", "value"),
    [
        ("transmission", {"transmission": YES}, -1.0),
        ("instruction", {"instructions": 3.0 * jnp.ones(1)}, -3.0),
        ("predicted", {"time_to_loss_s": jnp.full(1, 0.0)}, -1.0),
        ("predicted", {"time_to_loss_s": jnp.full(1, 75.0)}, -0.75),
        ("predicted", {"time_to_loss_s": jnp.full(1, 300.0)}, 0.0),
        ("loss", {"loss": YES}, -1.0),
        ("excursion", {"excursion": YES}, -1.0),
        ("wrong_level", {"exited": YES, "level_error_ticks": jnp.full(1, ticks(50.0))}, -1.5),
        ("wrong_level", {"level_error_ticks": jnp.full(1, ticks(50.0))}, 0.0),
        ("exit", {"exited": YES}, 1.0),
        ("exit", {"exited": YES, "level_error_ticks": jnp.full(1, 1.0)}, 0.0),
        ("level", {"nearer_level_ticks": jnp.full(1, ticks(10.0))}, 0.1),
        ("level", {"nearer_level_ticks": jnp.full(1, -ticks(10.0))}, -0.1),
        ("route", {"nearer_exit_nm": jnp.full(1, 5.0)}, 0.05),
        ("delay", {}, -1.0),
    ],
)
def test_each_term(term, change, value):
    paid = SECTOR_REWARDS[term].value(QUIET._replace(**change))
    assert float(paid[0]) == pytest.approx(value)


def test_the_total_is_the_weighted_sum():
    cycle = QUIET._replace(transmission=YES, loss=YES, nearer_exit_nm=jnp.full(1, 10.0))
    weights = SectorRewardSettings(transmission=2.0, loss=30.0, route=4.0, delay=0.5)
    assert float(total_reward(weights, cycle)[0]) == pytest.approx(-2.0 - 30.0 + 0.4 - 0.5)
    nothing = SectorRewardSettings(**dict.fromkeys(SECTOR_REWARDS, 0.0))
    assert float(total_reward(nothing, cycle)[0]) == 0.0
