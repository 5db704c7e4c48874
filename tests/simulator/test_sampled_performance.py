"""Performance sampled from another simulator."""

import jax.numpy as jnp
import numpy as np
import pytest

from skystack.simulator.performance import TICKS_PER_FL, Performance, TablePerformance
from skystack.simulator.sampled_performance import SampledPerformance
from tests.simulator.test_fleet import SLOW, array


def sampled(*tables):
    """The speeds and rates of tables at whole levels."""
    levels = jnp.arange(601.0) * TICKS_PER_FL
    rates = [
        [table.vertical_speed_ft_min(levels, jnp.full_like(levels, phase)) for phase in (1, 0, -1)]
        for table in tables
    ]
    return SampledPerformance(
        tuple(table.types[0] for table in tables),
        np.array([table.airspeeds_kt for table in tables]),
        np.array(rates),
    )


TABLES = (TablePerformance(), SLOW.table())
BOTH = sampled(*TABLES)


def test_it_is_a_performance_model():
    assert isinstance(BOTH, Performance)


@pytest.mark.parametrize("phase", [1.0, 0.0, -1.0])
@pytest.mark.parametrize("kind", [0, 1])
def test_agrees_with_the_tables_that_were_sampled(kind, phase):
    levels = array(0.0, 99.5, 123.25, 249.5, 250.0, 399.0, 400.0, 600.0) * TICKS_PER_FL
    phases, kinds = jnp.full_like(levels, phase), jnp.full(levels.shape, kind, dtype=jnp.int32)
    for name in ("true_airspeed_kt", "vertical_speed_ft_min"):
        found = getattr(BOTH, name)(levels, phases, kinds)
        assert np.array_equal(found, getattr(TABLES[kind], name)(levels, phases)), name


def test_cruise_speeds_are_those_of_each_kind():
    levels = np.array([150.0, 310.5])
    expected = np.concatenate([table.cruise_kt(levels) for table in TABLES])
    assert np.allclose(BOTH.cruise_kt(levels), expected)


def test_without_kinds_the_first_kind_is_used():
    levels, level_flight = array(300.0) * TICKS_PER_FL, array(0.0)
    first = BOTH.true_airspeed_kt(levels, level_flight, jnp.zeros(1, dtype=jnp.int32))
    assert np.array_equal(BOTH.true_airspeed_kt(levels, level_flight), first)


def test_rates_are_whole_ticks_per_second():
    odd = SampledPerformance(("B753",), BOTH.airspeeds_kt[:1], np.full((1, 3, 601), 1964.6))
    rate = odd.vertical_speed_ft_min(array(300.0) * TICKS_PER_FL, array(1.0))
    assert rate.tolist() == [1965.0]
