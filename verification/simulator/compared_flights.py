"""Flights that must agree: mirrored, shifted, exchanged, with fewer clearances, and in float64.

Each one uses the program of the original flight, except for float64, which has its own.
"""

from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from skystack.simulator.traffic import LEFT, NO_TURN, RIGHT, SHORTEST, Traffic
from verification.simulator.closed_form import Rows
from verification.simulator.invariants import (
    EXACT,
    Quantities,
    Tolerance,
    Values,
    Where,
    angle_deg,
    changed,
)
from verification.simulator.random_worlds import Flier, FlownWorld, World

UNDECIDED_DEG = 0.01
"""Turns this close to 180 degrees or to zero are not compared: rounding decides their direction."""
BOUNDS = {
    "the others are not cleared: same flight": EXACT,
    "it is not cleared: same flight as without clearances": EXACT,
    "two aircraft in the other order: same flights": EXACT,
    "mirrored: position": Tolerance(0.002, "NM"),
    "mirrored: heading": Tolerance(0.001, "deg"),
    "mirrored: level, speeds": EXACT,
    "shifted: position": Tolerance(0.002, "NM"),
    "shifted: heading, level, speeds": EXACT,
    "float64: position": Tolerance(0.001, "NM"),
    "float64: heading": Tolerance(0.001, "deg"),
    "float64: level": Tolerance(0.0, "ticks"),
    "float64, own navigation: position": Tolerance(0.2, "NM"),
    "float64, own navigation: heading": Tolerance(5.0, "deg"),
}
"""The bounds over all cycles of a world.

Between 128 and 256 NM from the origin float32 rounds to 1.5e-5 NM. At worst each of 60 cycles adds
half of that along both axes: 0.0007 NM, and twice that between two flights in float32. On own
navigation rounding may let a fly-by turn begin a second earlier or later.
"""


class Change(NamedTuple):
    """How worlds are changed for the comparison, with one entry per world."""

    shift_nm: Float[np.ndarray, " worlds"]
    """The shift to the east."""
    order: Int[np.ndarray, "aircraft worlds"]
    """The order of the aircraft, with two exchanged."""
    alone: Bool[np.ndarray, "aircraft worlds"]
    """The aircraft that alone is cleared."""


def draw_change(seed: int, number: int, aircraft: int) -> Change:
    """The change of the world with a number, without a batch axis."""
    random = np.random.default_rng([seed, number, 1])
    order = np.arange(aircraft)
    pair = random.permutation(aircraft)[:2]
    order[pair] = order[pair[::-1]]
    alone = np.arange(aircraft) == random.integers(aircraft)
    return Change(np.asarray(random.uniform(-50.0, 50.0)), order, alone)


def comparisons(flier: Flier, world: World, flown: FlownWorld, change: Change) -> Quantities:
    """All comparisons with other flights."""
    return {
        **_cleared_in_part(flier, world, flown, change),
        **_exchanged(flier, world, flown, change),
        **_mirrored(flier, world, flown, change),
        **_shifted(flier, world, flown, change),
        **_precise(flier, world, flown),
    }


def _cleared_in_part(flier: Flier, world: World, flown: FlownWorld, change: Change) -> Quantities:
    one = np.broadcast_to(change.alone, flown.after.active.shape)
    every = world.clearances
    none = every._replace(
        turn=np.full_like(every.turn, NO_TURN), changes_level=np.zeros_like(every.changes_level)
    )
    for_one = every._replace(
        turn=np.where(one, every.turn, NO_TURN), changes_level=every.changes_level & one
    )
    alone = flier.fly(world._replace(clearances=for_one)).after
    uncleared = flier.fly(world._replace(clearances=none)).after
    return {
        "the others are not cleared: same flight": (changed(flown.after, alone), one),
        "it is not cleared: same flight as without clearances": (changed(uncleared, alone), ~one),
    }


def _exchanged(flier: Flier, world: World, flown: FlownWorld, change: Change) -> Quantities:
    def exchange(leaf: np.ndarray, axis: int) -> np.ndarray:
        order = change.order
        while order.ndim < leaf.ndim - axis:
            order = order[:, None]
        return np.take_along_axis(leaf, order.reshape((1,) * axis + order.shape), axis)

    other = World(
        jax.tree.map(partial(exchange, axis=0), world.start),
        exchange(world.active, 1),
        jax.tree.map(partial(exchange, axis=1), world.clearances),
    )
    after = flier.fly(other).after
    there = jax.tree.map(partial(exchange, axis=1), after)
    everywhere = np.ones_like(after.active)
    return {
        "two aircraft in the other order: same flights": (changed(flown.after, there), everywhere)
    }


def _mirrored(flier: Flier, world: World, flown: FlownWorld, change: Change) -> Quantities:
    """Mirrored at the meridian of the origin, without aircraft on own navigation: routes stay."""
    start, clearances = world.start, world.clearances

    def mirror(heading: Values) -> Values:
        return (360.0 - heading.astype(float)).astype(np.float32) % np.float32(360.0)

    mirrored_start = start._replace(
        position_nm=_westward(start.position_nm), heading_deg=mirror(start.heading_deg)
    )
    other_way = np.select([clearances.turn == LEFT, clearances.turn == RIGHT], [RIGHT, LEFT])
    mirrored_clearances = clearances._replace(
        heading_deg=mirror(clearances.heading_deg),
        turn=np.where(other_way, other_way, clearances.turn).astype(np.int32),
    )
    mirrored = world._replace(start=mirrored_start, clearances=mirrored_clearances)
    there, here = flier.fly(mirrored).after, flown.after
    compared = ~start.own_navigation & decided(flown)
    vertical = ("level_ticks", "ground_speed_kt", "vertical_speed_ft_min")
    return {
        "mirrored: position": (
            apart_nm(there.position_nm, _westward(here.position_nm)),
            compared,
        ),
        "mirrored: heading": (apart_deg(there.heading_deg, 360.0 - here.heading_deg), compared),
        "mirrored: level, speeds": (
            changed(here, there, vertical),
            ~start.own_navigation & _all(here),
        ),
    }


def _westward(position_nm: Float[np.ndarray, "*axes 2 worlds"]) -> np.ndarray:
    """Positions with west and east exchanged."""
    return position_nm * np.array([[-1.0], [1.0]], dtype=position_nm.dtype)


def _shifted(flier: Flier, world: World, flown: FlownWorld, change: Change) -> Quantities:
    """Shifted to the east or west, along which the earth does not change."""
    start, here = world.start, flown.after
    shift = np.stack([change.shift_nm, np.zeros_like(change.shift_nm)])
    moved = (start.position_nm + shift).astype(np.float32)
    there = flier.fly(world._replace(start=start._replace(position_nm=moved))).after
    compared = ~start.own_navigation & _all(here)
    others = tuple(name for name in Traffic._fields if name != "position_nm")
    return {
        "shifted: position": (
            apart_nm(there.position_nm, here.position_nm.astype(float) + shift),
            compared,
        ),
        "shifted: heading, level, speeds": (changed(here, there, others), compared),
    }


def _precise(flier: Flier, world: World, flown: FlownWorld) -> Quantities:
    here, there = flown.after, flier.fly(world, "float64").after
    own, compared = world.start.own_navigation, decided(flown)
    apart = apart_nm(here.position_nm, there.position_nm)
    off = apart_deg(here.heading_deg, there.heading_deg)
    return {
        "float64: position": (apart, compared & ~own),
        "float64: heading": (off, compared & ~own),
        "float64: level": (np.abs(here.level_ticks - there.level_ticks), _all(here)),
        "float64, own navigation: position": (apart, compared & own),
        "float64, own navigation: heading": (off, compared & own),
    }


def decided(flown: FlownWorld) -> Where:
    """Where no turn so far is within `UNDECIDED_DEG` of zero or 180 degrees.

    Rounding may decide the direction of such turns. An exact half turn avoids north, so its
    direction is also different in a mirrored world.
    """
    instructed, after = flown.instructed, flown.after
    new = instructed.active & (instructed.pending_turn != NO_TURN)
    turn = np.abs(after.turn_deg)
    shortest = instructed.pending_turn == SHORTEST
    half = shortest & (np.abs(turn - 180.0) < UNDECIDED_DEG)
    none = ~shortest & (np.minimum(turn, 360.0 - turn) < UNDECIDED_DEG)
    return ~np.logical_or.accumulate(new & (half | (none & (turn > 0.0))), axis=0)


def apart_nm(a: np.ndarray, b: np.ndarray) -> Values:
    """Distances between positions `[cycles, aircraft, 2, worlds]`."""
    apart: Values = np.hypot(*np.moveaxis(a.astype(float) - b, 2, 0))
    return apart


def apart_deg(a: np.ndarray, b: np.ndarray) -> Values:
    """Absolute angles between headings."""
    return np.abs(angle_deg(a.astype(float), b.astype(float)))


def _all(traffic: Rows) -> Where:
    return np.ones_like(traffic.active)
