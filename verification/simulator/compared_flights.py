"""Flights that must come to the same: mirrored, shifted, exchanged, told in part, in float64.

Each is flown by the program that flew the world itself, float64 by one of its own.
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
"""A turn so near to half or to no turn that rounding decides its side is not compared."""
BOUNDS = {
    "told alone it flies as among others": EXACT,
    "untold it flies as if nobody was told": EXACT,
    "two exchanged fly exchanged": EXACT,
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
"""Over all cycles of a world.

Between 128 and 256 NM from the origin float32 rounds to 1.5e-5 NM. At worst each of 60 cycles adds
half of that along both axes: 0.0007 NM, and twice that between two flights in float32. On own
navigation rounding may let a fly-by turn begin a second earlier or later.
"""


class Change(NamedTuple):
    """What is done to a world to get the other one; one entry a world."""

    shift_nm: Float[np.ndarray, " worlds"]
    """To the east."""
    order: Int[np.ndarray, "aircraft worlds"]
    """Two aircraft exchanged."""
    alone: Bool[np.ndarray, "aircraft worlds"]
    """The one that is told."""


def draw_change(seed: int, number: int, aircraft: int) -> Change:
    """Of a world, by its number; without a batch axis."""
    random = np.random.default_rng([seed, number, 1])
    order = np.arange(aircraft)
    pair = random.permutation(aircraft)[:2]
    order[pair] = order[pair[::-1]]
    alone = np.arange(aircraft) == random.integers(aircraft)
    return Change(np.asarray(random.uniform(-50.0, 50.0)), order, alone)


def comparisons(flier: Flier, world: World, flown: FlownWorld, change: Change) -> Quantities:
    """All that is compared with other flights."""
    return {
        **_told_in_part(flier, world, flown, change),
        **_exchanged(flier, world, flown, change),
        **_mirrored(flier, world, flown, change),
        **_shifted(flier, world, flown, change),
        **_precise(flier, world, flown),
    }


def _told_in_part(flier: Flier, world: World, flown: FlownWorld, change: Change) -> Quantities:
    one = np.broadcast_to(change.alone, flown.after.active.shape)
    told = world.told
    silence = told._replace(
        turn=np.full_like(told.turn, NO_TURN), changes_level=np.zeros_like(told.changes_level)
    )
    to_one = told._replace(
        turn=np.where(one, told.turn, NO_TURN), changes_level=told.changes_level & one
    )
    alone = flier.fly(world._replace(told=to_one)).after
    silent = flier.fly(world._replace(told=silence)).after
    return {
        "told alone it flies as among others": (changed(flown.after, alone), one),
        "untold it flies as if nobody was told": (changed(silent, alone), ~one),
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
        jax.tree.map(partial(exchange, axis=1), world.told),
    )
    after = flier.fly(other).after
    there = jax.tree.map(partial(exchange, axis=1), after)
    everywhere = np.ones_like(after.active)
    return {"two exchanged fly exchanged": (changed(flown.after, there), everywhere)}


def _mirrored(flier: Flier, world: World, flown: FlownWorld, change: Change) -> Quantities:
    """At the meridian of the origin. Routes stay as they are: without who flies them."""
    begun = world.start

    def mirror(heading: Values) -> Values:
        return (360.0 - heading.astype(float)).astype(np.float32) % np.float32(360.0)

    start = begun._replace(
        position_nm=_westward(begun.position_nm), heading_deg=mirror(begun.heading_deg)
    )
    other_way = np.select([world.told.turn == LEFT, world.told.turn == RIGHT], [RIGHT, LEFT])
    told = world.told._replace(
        heading_deg=mirror(world.told.heading_deg),
        turn=np.where(other_way, other_way, world.told.turn).astype(np.int32),
    )
    there = flier.fly(world._replace(start=start, told=told)).after
    here = flown.after
    compared = ~begun.own_navigation & decided(flown)
    vertical = ("level_ticks", "ground_speed_kt", "vertical_speed_ft_min")
    return {
        "mirrored: position": (
            apart_nm(there.position_nm, _westward(here.position_nm)),
            compared,
        ),
        "mirrored: heading": (apart_deg(there.heading_deg, 360.0 - here.heading_deg), compared),
        "mirrored: level, speeds": (
            changed(here, there, vertical),
            ~begun.own_navigation & _all(here),
        ),
    }


def _westward(position_nm: Float[np.ndarray, "*axes 2 worlds"]) -> np.ndarray:
    """West for east."""
    return position_nm * np.array([[-1.0], [1.0]], dtype=position_nm.dtype)


def _shifted(flier: Flier, world: World, flown: FlownWorld, change: Change) -> Quantities:
    """To the east or west, where the earth is the same."""
    begun, here = world.start, flown.after
    shift = np.stack([change.shift_nm, np.zeros_like(change.shift_nm)])
    moved = (begun.position_nm + shift).astype(np.float32)
    there = flier.fly(world._replace(start=begun._replace(position_nm=moved))).after
    compared = ~begun.own_navigation & _all(here)
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
    """Where no turn so far was so near to half or to no turn that rounding decides its side.

    By the rule that half a turn passes through no north, it has another side in a mirrored world.
    """
    told, after = flown.told, flown.after
    new = told.active & (told.pending_turn != NO_TURN)
    turn = np.abs(after.turn_deg)
    half = (told.pending_turn == SHORTEST) & (np.abs(turn - 180.0) < UNDECIDED_DEG)
    none = (told.pending_turn != SHORTEST) & (np.minimum(turn, 360.0 - turn) < UNDECIDED_DEG)
    return ~np.logical_or.accumulate(new & (half | (none & (turn > 0.0))), axis=0)


def apart_nm(a: np.ndarray, b: np.ndarray) -> Values:
    """Distances between positions `[cycles, aircraft, 2, worlds]`."""
    apart: Values = np.hypot(*np.moveaxis(a.astype(float) - b, 2, 0))
    return apart


def apart_deg(a: np.ndarray, b: np.ndarray) -> Values:
    """Angles between headings, without their side."""
    return np.abs(angle_deg(a.astype(float), b.astype(float)))


def _all(traffic: Rows) -> Where:
    return np.ones_like(traffic.active)
