"""Losses of separation at their limits: 100,000 pairs against brute force every 0.01 s.

The function runs compiled as for users, compiled at every optimisation level, and uncompiled.
"""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.airspace.projection import WGS84, MercatorPlane
from skystack.airspace.sector import Sector
from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.separation import pair_distance_squared

PAIRS = 100_000
STEPS = 600
"""The steps of brute force in a cycle, 0.01 s each."""
PLANES = {"equator": MercatorPlane(0.0, 0.0), "north": MercatorPlane(62.5, 15.0)}
LOSS_BELOW_NM = Sector("", (0.0, 0.0), (), (0, 1), {}, ()).loss_below_nm
GAPS_FT = np.array([0, 500, 990, 1000, 1000, 1010, 1500])
IN_TRAIL_NM = np.array([4.999, 5.0, 5.001])


@cache
def pairs(place):
    """Positions before and after a cycle, then levels before and after it, of two aircraft.

    The arrays are `[2, ..., pairs]` in float32. A fifth of the pairs stay exactly 4.999, 5.000 or
    5.001 NM apart. Many start or end the cycle 990, 1,000 or 1,010 ft apart, and in some one
    aircraft passes through the level of the other.
    """
    plane, rng = PLANES[place], np.random.default_rng(len(place))
    first = rng.uniform(-200.0, 200.0, (PAIRS, 2))
    angle = rng.uniform(0.0, 2.0 * np.pi, PAIRS)
    distance = rng.uniform(0.0, 10.0, PAIRS)
    in_trail = rng.random(PAIRS) < 0.2
    distance[in_trail] = rng.choice(IN_TRAIL_NM, in_trail.sum())
    heading = rng.uniform(0.0, 2.0 * np.pi, (2, PAIRS))
    speed = rng.uniform(250.0, 500.0, (2, PAIRS)) / 600.0
    # Along a parallel, because meridians converge: northbound aircraft would not keep their
    # distance.
    angle[in_trail] = rng.choice([0.5 * np.pi, 1.5 * np.pi], in_trail.sum())
    heading[:, in_trail] = rng.choice([0.5 * np.pi, 1.5 * np.pi], in_trail.sum())
    speed[1, in_trail] = speed[0, in_trail]
    scale = plane.scale(first[:, 1:])

    def along(angle, length):
        return length[:, None] * np.array([np.sin(angle), np.cos(angle)]).T * scale

    second = first + along(angle, distance)
    before = np.stack([first, second])
    after = before + np.stack([along(heading[n], speed[n]) for n in range(2)])
    level = np.round(rng.uniform(280.0, 320.0, (2, PAIRS))) * TICKS_PER_FL
    gap = rng.choice(GAPS_FT, PAIRS) * rng.choice([-1, 1], PAIRS) * TICKS_PER_FL / 100.0
    climb = rng.integers(-8000, 8001, (2, PAIRS)) * 6.0
    climb[:, rng.random(PAIRS) < 0.3] = 0.0
    gap_after = gap + climb[1] - climb[0]
    # Three in ten level off 990, 1,000 or 1,010 ft apart at the end of the cycle.
    off = rng.random(PAIRS) < 0.3
    gap_after[off] = np.sign(gap[off]) * rng.choice(GAPS_FT[2:6], off.sum()) * TICKS_PER_FL / 100.0
    level[1] = level[0] + gap
    level_after = np.stack([level[0] + climb[0], level[0] + climb[0] + gap_after])
    arrays = before.transpose(0, 2, 1), after.transpose(0, 2, 1), level, level_after
    return tuple(np.asarray(array, dtype=np.float32) for array in arrays)


@cache
def brute_force(place):
    """The minimum distance [NM] while less than 1,000 ft apart, in float64; infinite if never."""
    plane, minima = PLANES[place], []
    time = np.linspace(0.0, 1.0, STEPS + 1)[:, None]
    for part in range(0, PAIRS, 5000):
        chosen = (array[..., part : part + 5000].astype(np.float64) for array in pairs(place))
        before, after, level, level_after = chosen
        x, y = (before[:, i] + time[:, None] * (after - before)[:, i] for i in range(2))
        scale = plane.scale((y[:, 0] + y[:, 1]) / 2.0)
        distance = np.hypot(x[:, 1] - x[:, 0], y[:, 1] - y[:, 0]) / scale
        # In ticks times steps, which are whole numbers, so that the comparison is exact.
        gap = (level[1] - level[0]) * STEPS
        change = (level_after[1] - level_after[0]) * STEPS - gap
        apart = np.abs(gap + np.round(time * STEPS) * (change / STEPS))
        close = apart < 10 * TICKS_PER_FL * STEPS
        minima.append(np.where(close, distance, np.inf).min(axis=0))
    return np.concatenate(minima)


def measured(place, function):
    return np.sqrt(np.asarray(function(*map(jnp.asarray, pairs(place))))[0])


def closed_form(place):
    return partial(pair_distance_squared, PLANES[place], 10)


@pytest.mark.slow
@pytest.mark.parametrize("place", PLANES)
def test_losses_agree_with_brute_force(place):
    found, exact = measured(place, jax.jit(closed_form(place))), brute_force(place)
    # Only brute force misses pairs: those within 1,000 ft for less than one of its steps.
    assert not np.any(np.isinf(found) & np.isfinite(exact))
    both = np.isfinite(found) & np.isfinite(exact)
    # Brute force misses the minimum, by most where a level change ends the time within 1,000 ft.
    assert np.all(found[both] <= exact[both] + 5e-5)
    assert np.all(found[both] >= exact[both] - 0.005)
    lost, expected = found < LOSS_BELOW_NM, exact < LOSS_BELOW_NM
    differ = lost != expected
    assert np.all(np.abs(found[differ] - LOSS_BELOW_NM) < 0.005)
    assert differ.sum() < PAIRS / 1000
    assert lost.sum() > PAIRS / 10


@pytest.mark.slow
@pytest.mark.parametrize("place", PLANES)
def test_losses_do_not_depend_on_compilation_or_batching(place):
    function, arrays = closed_form(place), [jnp.asarray(array) for array in pairs(place)]
    eager = measured(place, function) < LOSS_BELOW_NM
    for level in range(4):
        options = {"xla_backend_optimization_level": level}
        compiled = jax.jit(function).lower(*arrays).compile(compiler_options=options)
        assert np.array_equal(measured(place, compiled) < LOSS_BELOW_NM, eager)
    mapped = measured(place, jax.jit(jax.vmap(function, -1, -1)))
    assert np.array_equal(mapped < LOSS_BELOW_NM, eager)
    single = jax.jit(function)
    for number in range(0, PAIRS, PAIRS // 500):
        one = single(*(array[..., number] for array in arrays))
        assert (np.sqrt(one)[0] < LOSS_BELOW_NM) == eager[number]


@pytest.mark.parametrize("place", PLANES)
def test_separation_is_lost_only_below_5_nm(place):
    plane, rng = PLANES[place], np.random.default_rng(3)
    for distance, lost in zip(IN_TRAIL_NM, (True, False, False), strict=True):
        first = rng.uniform(-200.0, 200.0, (1000, 2))
        lat, lon = plane.to_degrees(first).T
        lon, lat, _ = WGS84.fwd(lon, lat, np.full(1000, 90.0), np.full(1000, distance * 1852.0))
        at = np.stack([first, plane.to_plane(lat, lon)]).transpose(0, 2, 1).astype(np.float32)
        level = np.full((2, 1000), 300 * TICKS_PER_FL, dtype=np.float32)
        found = np.sqrt(closed_form(place)(at, at, level, level))[0]
        assert np.all((found < LOSS_BELOW_NM) == lost)


@pytest.mark.parametrize(
    ("before_ft", "after_ft", "close"),
    [
        ((0, 1000), (0, 1000), False),
        ((0, 990), (0, 990), True),
        ((0, 1010), (0, 1010), False),
        ((0, 4000), (0, 1000), False),  # levels off at the limit
        ((0, 1000), (0, 4000), False),  # starts at the limit
        ((0, 1250), (250, 1250), False),  # the lower one climbs to it
        ((0, 1000), (250, 1250), False),  # both climb
        ((0, 1001), (0, 999), True),
        ((0, 1100), (1200, 0), True),  # one passes the other
        ((1100, 0), (0, 1200), True),
        ((0, 0), (0, 2000), True),
    ],
)
def test_exactly_1000_ft_is_separated(before_ft, after_ft, close):
    at = np.zeros((2, 2), dtype=np.float32)
    level, level_after = (
        np.asarray(feet, dtype=np.float32) * (TICKS_PER_FL / 100.0)
        for feet in (before_ft, after_ft)
    )
    for function in (closed_form("equator"), jax.jit(closed_form("equator"))):
        found = function(at, at, level, np.asarray(level_after, dtype=np.float32))
        assert np.isfinite(found[0]) == close


@pytest.mark.parametrize(("feet", "lost"), [(1990, True), (2000, False)])
def test_uses_the_given_vertical_standard(feet, lost):
    at = np.zeros((2, 2), dtype=np.float32)
    level = np.array([0.0, feet * TICKS_PER_FL / 100.0], dtype=np.float32)
    found = pair_distance_squared(PLANES["equator"], 20, at, at, level, level)
    assert np.isfinite(found[0]) == lost
