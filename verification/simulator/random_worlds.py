"""Random worlds for testing the simulator: aircraft, and their clearances in each cycle.

A world depends only on the seed and its number. Worlds of one setting are flown together, along the
last axis of every array.
"""

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from skystack.airspace.sectors import sector_named, sector_names
from skystack.compilation.fetch import fetched
from skystack.simulator.fleet import AircraftType, fleet
from skystack.simulator.performance import PERFORMANCE, TICKS_PER_FL
from skystack.simulator.simulator import Simulator, instruct
from skystack.simulator.traffic import NO_TURN, Clearance, Traffic, start
from verification.simulator.closed_form import Rows, limits

Tree = TypeVar("Tree")

CYCLES = 60
"""The number of cycles of a world: six minutes."""
HALF_WIDTH_NM = 140.0
"""Half the width of the square in which aircraft start, within the limits of a sector."""
HIGHEST_FL = 450
"""The highest level; the lowest is FL10, and the table's ceiling is FL400."""
FLEET = fleet(
    (
        AircraftType(),
        AircraftType(
            type="AT76", low_cas_kt=(160.0, 170.0, 180.0), high_cas_kt=(160.0, 170.0, 180.0),
            mach=(0.4, 0.44, 0.42), rate_ft_min=1200.0, ceiling_fl=250.0,
        ),
        AircraftType(type="C56X", mach=(0.7, 0.75, 0.72), rate_ft_min=4000.0, ceiling_fl=450.0),
    )
)  # fmt: skip
MODELS: dict[str, Any] = {**PERFORMANCE, "fleet": FLEET}


class Setting(NamedTuple):
    """The properties that worlds of one compiled program share."""

    sector: str
    model: str
    own_navigation: bool
    aircraft: int

    def simulator(self) -> Simulator:
        return Simulator(sector_named(self.sector), MODELS[self.model], self.own_navigation)


_NAVIGATING = (0, 5, 7, 10)
"""The settings with own navigation: one in each sector, and each model at least once."""
_SECTORS, _MODELS = sector_names(), list(MODELS)
SETTINGS = tuple(
    Setting(_SECTORS[n % len(_SECTORS)], _MODELS[n % len(_MODELS)], n in _NAVIGATING, n + 1)
    for n in range(12)
)
"""1 to 12 aircraft, and every shipped sector with every performance model. World n has the setting
n modulo 12."""


def setting_of(number: int) -> Setting:
    """The setting of the world with a number."""
    return SETTINGS[number % len(SETTINGS)]


class Start(NamedTuple):
    """The aircraft at the start: the fields of `Traffic` that are drawn."""

    position_nm: np.ndarray
    heading_deg: np.ndarray
    level_ticks: np.ndarray
    route: np.ndarray
    next_fix: np.ndarray
    own_navigation: np.ndarray
    kind: np.ndarray


class World(NamedTuple):
    """The start and all clearances of one world, or of many along the last axis."""

    start: Start
    active: Bool[np.ndarray, "cycles aircraft *batch"]
    clearances: Rows
    """`Clearance` arrays `[cycles, aircraft, *batch]`."""


class FlownWorld(NamedTuple):
    """A flight as `Traffic` arrays `[cycles, ...]`."""

    before: Rows
    """The traffic before each cycle."""
    instructed: Rows
    """The same traffic after `instruct`."""
    after: Rows
    """The traffic after `advance`."""


def draw(seed: int, number: int) -> World:
    """The world with a number, without a batch axis."""
    setting = setting_of(number)
    random = np.random.default_rng([seed, number])
    shape = (CYCLES, setting.aircraft)
    return World(
        start=_start(random, setting),
        active=_active(random, shape),
        clearances=_clearances(random, shape),
    )


def _start(random: np.random.Generator, setting: Setting) -> Start:
    """Level flight at any position, heading and level.

    Half of the headings are whole degrees, and half of the levels are multiples of 10.
    Half of the aircraft are near the leg to their next fix and point along it, so that fly-by turns
    are frequent.
    """
    count, table = setting.aircraft, sector_named(setting.sector).route_table
    position = random.uniform(-HALF_WIDTH_NM, HALF_WIDTH_NM, (count, 2))
    heading, level = random.uniform(0.0, 360.0, count), random.uniform(10.0, HIGHEST_FL, count)
    heading = np.where(random.random(count) < 0.5, np.floor(heading), heading)
    level = np.where(random.random(count) < 0.5, np.round(level, -1), level)
    route = random.integers(0, len(table.last_fix), count, dtype=np.int32)
    fix = 1 + (random.random(count) * table.last_fix[route]).astype(np.int32)
    leg = table.fixes_nm[route, fix] - table.fixes_nm[route, fix - 1]
    near_leg = table.fixes_nm[route, fix] - random.random((count, 1)) * leg
    near_leg += random.uniform(-2.0, 2.0, (count, 2))
    routed, along = random.random(count) < 0.5, np.degrees(np.arctan2(leg[:, 0], leg[:, 1]))
    heading = np.where(routed, along + random.uniform(-20.0, 20.0, count), heading)
    return Start(
        position_nm=np.where(routed[:, None], near_leg, position).astype(np.float32),
        heading_deg=heading.astype(np.float32) % np.float32(360.0),
        level_ticks=np.round(level * TICKS_PER_FL).astype(np.float32),
        route=route,
        next_fix=fix,
        own_navigation=(random.random(count) < 0.5) & setting.own_navigation,
        kind=random.integers(0, len(MODELS[setting.model].types), count, dtype=np.int32),
    )


def _active(random: np.random.Generator, shape: tuple[int, int]) -> Bool[np.ndarray, "c aircraft"]:
    """When aircraft are active: always, except that two in five are inactive in one period."""
    cycle = np.arange(shape[0])[:, None]
    first, last = np.sort(random.integers(-10, shape[0] + 10, (2, shape[1])), axis=0)
    return (random.random(shape[1]) < 0.6) | (cycle < first) | (cycle >= last)


def _clearances(random: np.random.Generator, shape: tuple[int, int]) -> Rows:
    """Random clearances: headings in 30 %, 10 % or none of the cycles, levels in 10 %.

    Half of the headings are an aircraft's favourite, 10 degrees next to it or its opposite, so that
    repeated headings and half turns are frequent.
    """
    share = random.choice([0.0, 0.1, 0.3], shape[1])
    favourite = random.integers(0, 360, shape[1]) + random.choice([0, 0, 10, -10, 180], shape)
    heading = np.where(random.random(shape) < 0.5, favourite, random.integers(0, 360, shape)) % 360
    turn = np.where(random.random(shape) < share, random.integers(1, 4, shape), NO_TURN)
    level = 10 * random.integers(1, HIGHEST_FL // 10 + 1, shape) * TICKS_PER_FL
    fields: Any = {
        "turn": turn.astype(np.int32),
        "heading_deg": heading.astype(np.float32),
        "changes_level": random.random(shape) < 0.1,
        "level_ticks": level.astype(np.float32),
    }
    return Clearance(**fields)


def concatenate_worlds(each: list[Tree]) -> Tree:
    """The same trees of several worlds, stacked along the last axis."""
    return jax.tree.map(lambda *leaves: np.stack(leaves, axis=-1), *each)


class Flier:
    """Flies worlds of one setting, with one program per number of worlds and precision."""

    def __init__(self, setting: Setting) -> None:
        self.simulator = setting.simulator()
        self.limits = limits(MODELS[setting.model])
        self._compiled = jax.jit(self._fly)

    def fly(self, world: World, dtype: str = "float32") -> FlownWorld:
        """Fly all cycles from the same start, computed in `dtype`; returns numpy arrays."""
        with jax.enable_x64(dtype == "float64"), jax.numpy_dtype_promotion("standard"):
            converted = jax.tree.map(
                lambda leaf: leaf.astype(dtype) if leaf.dtype.kind == "f" else leaf, world
            )
            return fetched(self._compiled(converted))

    def _fly(self, world: Any) -> FlownWorld:
        def cycle(before: Traffic, inputs: Any) -> tuple[Traffic, FlownWorld]:
            active, clearance = inputs
            before = before._replace(active=active)
            instructed = instruct(before, clearance)
            after = self.simulator.advance(instructed)
            return after, FlownWorld(before, instructed, after)

        initial = world.start
        traffic = start(
            initial.position_nm,
            initial.heading_deg,
            initial.level_ticks,
            initial.route,
            jnp.zeros_like(initial.level_ticks),  # not known before the first cycle
            initial.own_navigation,
            initial.kind,
        )
        traffic = traffic._replace(next_fix=initial.next_fix)
        return jax.lax.scan(cycle, traffic, (world.active, world.clearances))[1]
