"""Helpers of the simulator's tests: traffic from plain numbers, flights, stored rollouts."""

import csv
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from skystack.airspace.projection import WGS84
from skystack.airspace.sector import Sector
from skystack.airspace.xplus import x_plus
from skystack.simulator.performance import TICKS_PER_FL, performance
from skystack.simulator.simulator import Simulator, instruct
from skystack.simulator.traffic import NO_TURN, SHORTEST, Clearance, Traffic, start, ticks

MODELS = ("constant", "table")


class TimedClearance(NamedTuple):
    """A clearance issued before cycle `cycle` (from 0) is flown."""

    cycle: int
    aircraft: int
    heading_deg: float | None = None
    fl: float | None = None
    turn: int = SHORTEST


def clearance(aircraft: int, clearances: Iterable[TimedClearance]) -> Clearance:
    """The clearances of one cycle as arrays."""
    turn = np.full(aircraft, NO_TURN, dtype=np.int32)
    heading, level = np.zeros((2, aircraft), dtype=np.float32)
    changes_level = np.zeros(aircraft, dtype=bool)
    for entry in clearances:
        if entry.heading_deg is not None:
            turn[entry.aircraft], heading[entry.aircraft] = entry.turn, entry.heading_deg
        if entry.fl is not None:
            changes_level[entry.aircraft], level[entry.aircraft] = True, ticks(entry.fl)
    return Clearance(*(jnp.asarray(a) for a in (turn, heading, changes_level, level)))


class Flights:
    """Flies traffic in one simulator; compiled once for each number of aircraft."""

    def __init__(self, sector: Sector, model: str, own_navigation: bool = False):
        self.simulator = Simulator(sector, performance(model), own_navigation)
        self.cycle = jax.jit(
            lambda traffic, clearances: self.simulator.advance(instruct(traffic, clearances))
        )

    def start(
        self, position_nm, heading_deg, fl=300.0, route: Sequence[int] = (), own_navigation=False
    ) -> Traffic:
        """Traffic in level flight; single numbers hold for all aircraft."""
        position = jnp.asarray(position_nm, dtype=jnp.float32)
        n = len(position)
        level = jnp.asarray(np.round(np.broadcast_to(fl, n) * TICKS_PER_FL), dtype=jnp.float32)
        return start(
            position,
            jnp.asarray(np.broadcast_to(heading_deg, n), dtype=jnp.float32),
            level,
            jnp.asarray(route if len(route) else [0] * n, dtype=jnp.int32),
            self.simulator.level_ground_speed_kt(level),
            jnp.asarray(np.broadcast_to(own_navigation, n)),
        )

    def fly(
        self, traffic: Traffic, cycles: int, clearances: Sequence[TimedClearance] = ()
    ) -> Traffic:
        """The traffic of rows 0 to `cycles`, `[row, aircraft]`, as numpy arrays."""
        n = len(traffic.heading_deg)
        none = clearance(n, ())
        issued = {
            k: clearance(n, (each for each in clearances if each.cycle == k))
            for k, *_ in clearances
        }
        rows = [traffic]
        for k in range(cycles):
            rows.append(self.cycle(rows[-1], issued.get(k, none)))
        return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *rows)


@cache
def flights(model: str, own_navigation: bool = False) -> Flights:
    """Flights in the X-Plus sector."""
    return Flights(x_plus(), model, own_navigation)


def angle_between_deg(a, b):
    """The absolute angle between headings, at most 180 degrees."""
    return np.abs((np.asarray(a) - np.asarray(b) + 180.0) % 360.0 - 180.0)


class Reference(NamedTuple):
    """A stored rollout of BluebirdDT, `[stored row, aircraft]`, with the number of each row."""

    row: np.ndarray
    lat_lon: np.ndarray
    heading_deg: np.ndarray
    fl: np.ndarray
    selected_heading_deg: np.ndarray
    """NaN for none."""
    selected_fl: np.ndarray
    ground_speed_kt: np.ndarray


def reference(file: str, rollout: str, model: str) -> Reference:
    """A rollout from a table in `data`, aircraft in the order of their callsigns."""
    with (Path(__file__).parent / "data" / file).open(encoding="utf-8") as lines:
        table = [
            line
            for line in csv.DictReader(line for line in lines if not line.startswith("#"))
            if (line["rollout"], line["performance"]) == (rollout, model)
        ]
    callsigns = sorted({line["callsign"] for line in table})

    def column(name):
        values = [float(line[name] or "nan") if name in line else np.nan for line in table]
        return np.array(values).reshape(-1, len(callsigns))

    assert [line["callsign"] for line in table] == callsigns * (len(table) // len(callsigns))
    return Reference(
        row=column("row")[:, 0].astype(int),
        lat_lon=np.stack([column("lat"), column("lon")], axis=-1),
        heading_deg=column("heading_deg"),
        fl=column("fl"),
        selected_heading_deg=column("selected_heading_deg"),
        selected_fl=column("selected_fl"),
        ground_speed_kt=column("ground_speed_kt"),
    )


def geodesic_nm(a_lat_lon, b_lat_lon):
    """Geodesic distances between points given in degrees."""
    a, b = np.broadcast_arrays(a_lat_lon, b_lat_lon)
    return WGS84.inv(a[..., 1], a[..., 0], b[..., 1], b[..., 0])[2] / 1852.0
