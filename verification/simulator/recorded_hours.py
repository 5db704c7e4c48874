"""Fly hours recorded in another simulator again in ours, with the same births and clearances.

    skystack flight-school search --platform bluebird --seeds 20
    python -m verification.simulator.recorded_hours runs/flight-school/search-...

Reads the tables of the hours. Prints, for each hour, the largest distance between flown and
recorded positions, the number of positions at a different level, and the number of flights that
leave in a different cycle. Needs no other simulator. The exit code is 1 if positions differ by more
than 0.02 NM, or any level or exit differs, and 2 for invalid input.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Array
from rich.console import Console

from skystack.agents.transmission import Transmission
from skystack.airspace.sector import Sector
from skystack.errors import InputError
from skystack.evaluation.hours import OwnHours
from skystack.evaluation.stored import read_table, sector_of
from skystack.simulator.arrival_flows import Flow
from skystack.simulator.arrivals import FREE, Candidates, Clock
from skystack.simulator.performance import TICKS_PER_FL, ConstantPerformance, performance
from skystack.simulator.simulator import CYCLE_S, Simulator
from skystack.simulator.traffic import ticks
from skystack.tasks.sector_world import World, WorldState

BOUND_NM, LEVEL_FL = 0.02, 1e-3
SLOTS, MOST_FLIGHTS = 192, 1024
NEVER_S = 1e9
"""The time of birth of candidates that are not used."""


class Track(NamedTuple):
    """A flight as it was recorded, one row for each cycle that it was flown."""

    route: tuple[str, ...]
    exit_fl: float
    cycle: np.ndarray
    lat: np.ndarray
    lon: np.ndarray
    fl: np.ndarray
    heading_deg: np.ndarray
    speed_kt: float
    starts: bool
    """Whether it is there from the start."""
    gone_cycle: int | None


class Recorded(NamedTuple):
    """A recorded hour."""

    tracks: list[Track]
    sent: dict[int, list[tuple[int, Transmission]]]
    """Transmissions by cycle, each with the index of its track. Their `slot` is not used."""
    cycles: int


class Agreement(NamedTuple):
    """How far the flights of an hour are from where they were recorded."""

    flights: int
    rows: int
    worst_nm: float
    far_rows: int
    """Rows more than `BOUND_NM` away."""
    far_flights: int
    """The flights of these rows."""
    wrong_levels: int
    """Rows at a different level."""
    wrong_exits: int
    """Flights that leave in a different cycle."""


def read_hour(folder: Path, number: int) -> Recorded:
    """Read an hour from the tables of an evaluation. Raises InputError if they are damaged."""
    of_hour = [("scenario", "=", number)]
    names = ("callsign", "route", "exit_fl", "gone_cycle")
    path = folder / "aircraft.parquet"
    read_table(path, names[:-1], of_hour)  # raises InputError if it is damaged
    flights = pq.read_table(path, columns=list(names), filters=of_hour).to_pylist()
    columns = ("callsign", "cycle", "lat", "lon", "fl", "heading_deg", "ground_speed_kt")
    rows = _by_callsign(read_table(folder / "trajectories.parquet", columns, of_hour))
    tracks = [_track(each, rows[each["callsign"]]) for each in flights]
    index = {each["callsign"]: number for number, each in enumerate(flights)}
    parts = ("cycle", "transmission", "callsign", "kind", "value")
    clearances = read_table(folder / "clearances.parquet", parts, of_hour).to_pylist()
    sent: dict[int, list[tuple[int, Transmission]]] = {}
    told: dict[int, tuple[int, int, Transmission]] = {}
    for row in clearances:
        _, _, before = told.get(row["transmission"], (0, 0, Transmission(0)))
        at = (row["cycle"], index[row["callsign"]])
        told[row["transmission"]] = (*at, _with(before, row["kind"], row["value"]))
    for cycle, flight, transmission in told.values():
        sent.setdefault(cycle, []).append((flight, transmission))
    episodes = read_table(folder / "episodes.parquet", ("cycles",), of_hour)
    return Recorded(tracks, sent, episodes["cycles"][0].as_py())


def _by_callsign(table: pa.Table) -> dict[str, pa.Table]:
    callsigns = table["callsign"].cast(pa.string())
    return {
        name: table.filter(pc.equal(callsigns, name)) for name in pc.unique(callsigns).to_pylist()
    }


def _with(transmission: Transmission, kind: str, value: int) -> Transmission:
    if kind == "heading":
        return transmission._replace(heading_deg=value)
    if kind == "direct":
        return transmission._replace(fix=value)
    return transmission._replace(level_ticks=ticks(float(value)))


def _track(flight: dict[str, Any], rows: pa.Table) -> Track:
    """The rows of a flight from the last one in which it is still held at its birth."""
    values = {name: rows[name].to_numpy() for name in rows.column_names if name != "callsign"}
    still = (values["lat"] == values["lat"][0]) & (values["lon"] == values["lon"][0])
    first = int(np.argmin(still)) if not still.all() else len(still)
    kept = {name: each[max(first - 1, 0) :] for name, each in values.items()}
    return Track(
        route=tuple(flight["route"].split()),
        exit_fl=float(flight["exit_fl"]),
        cycle=kept["cycle"],
        lat=kept["lat"],
        lon=kept["lon"],
        fl=kept["fl"],
        heading_deg=kept["heading_deg"],
        speed_kt=float(kept["ground_speed_kt"][0]),
        starts=first == 1 and int(values["cycle"][0]) == 1,
        gone_cycle=flight["gone_cycle"],
    )


def agreement(sector: Sector, hour: Recorded) -> Agreement:
    """Fly a recorded hour in our simulator."""
    simulator = Simulator(sector, performance("constant"), own_navigation=True)
    clock = Clock(0.0, recorded=True, held_cycles=1)
    world = World(Flow(simulator, clock, SLOTS, hour.cycles + 1, MOST_FLIGHTS))
    hours, order = OwnHours(world), _order(hour.tracks)
    state = _begin(world, hours.reset(0, 0), [hour.tracks[index] for index in order])
    number = {flight: rank for rank, flight in enumerate(order)}
    apart_nm, levels = dict[int, list[float]](), list[bool]()
    left: dict[int, int] = {}
    # Flights are born one cycle before they move, so all is one cycle later than recorded.
    state, _ = hours.advance(state, [])
    for cycle in range(hour.cycles):
        slots = {int(each): slot for slot, each in enumerate(state.arrivals.flight)}
        told = [
            each._replace(slot=slots[number[flight]])
            for flight, each in hour.sent.get(cycle, ())
            if number[flight] in slots
        ]
        state, flown = hours.advance(state, told)
        for slot in np.flatnonzero(flown.flight != FREE).tolist():
            index = order[int(flown.flight[slot])]
            if flown.exited[slot] or flown.excursion[slot]:
                left[index] = cycle + 1
            track = hour.tracks[index]
            row = cycle + 1 - int(track.cycle[0])
            if 0 <= row < len(track.cycle):
                there = sector.plane.to_plane(track.lat[row], track.lon[row])
                scale = float(sector.plane.scale(there[1:])[0])
                offset_nm = np.hypot(*(flown.traffic.position_nm[slot] - there)) / scale
                apart_nm.setdefault(index, []).append(float(offset_nm))
                level_fl = float(flown.traffic.level_ticks[slot]) / TICKS_PER_FL
                levels.append(abs(level_fl - track.fl[row]) > LEVEL_FL)
    wrong = sum(left.get(index) != each.gone_cycle for index, each in enumerate(hour.tracks))
    far = [sum(each > BOUND_NM for each in offsets) for offsets in apart_nm.values()]
    return Agreement(
        flights=len(hour.tracks),
        rows=len(levels),
        worst_nm=max(max(offsets) for offsets in apart_nm.values()),
        far_rows=sum(far),
        far_flights=sum(count > 0 for count in far),
        wrong_levels=sum(levels),
        wrong_exits=wrong,
    )


def _order(tracks: Sequence[Track]) -> list[int]:
    """The tracks in order of birth."""
    return sorted(range(len(tracks)), key=lambda index: int(tracks[index].cycle[0]))


def _begin(world: World, state: WorldState, tracks: Sequence[Track]) -> WorldState:
    """The state without flights, in which the tracks are born in this order.

    Starters have no row before their first cycle, in which they fly straight on.
    """
    sector, model = world.sector, world.simulator.performance
    assert isinstance(model, ConstantPerformance)
    routes = {tuple(route): index for index, route in enumerate(sector.routes)}
    starts = np.array([each.starts for each in tracks])
    position = sector.plane.to_plane(*np.array([(each.lat[0], each.lon[0]) for each in tracks]).T)
    heading = np.array([float(each.heading_deg[0]) for each in tracks])
    speed_kt = np.array([each.speed_kt for each in tracks])
    flown_nm = speed_kt * CYCLE_S / 3600.0 * sector.plane.scale(position[:, 1])
    back = np.stack([np.sin(np.radians(heading)), np.cos(np.radians(heading))], axis=1)
    values = {
        "due_s": CYCLE_S * np.where(starts, 0, [int(each.cycle[0]) for each in tracks]),
        "position_nm": position - np.where(starts, flown_nm, 0.0)[:, None] * back,
        "heading_deg": heading,
        "entry_level_ticks": np.array([ticks(float(each.fl[0])) for each in tracks]),
        "exit_level_ticks": np.array([ticks(each.exit_fl) for each in tracks]),
        "airspeed_factor": speed_kt / model.airspeed_kt,
        "climb_factor": np.ones(len(tracks)),
    }
    route = np.array([routes[each.route] for each in tracks])
    unused = MOST_FLIGHTS - len(tracks)
    if unused < 0:
        raise InputError(f"{len(tracks)} flights (allowed: {MOST_FLIGHTS})")

    def padded(name: str, each: np.ndarray) -> Array:
        empty = NEVER_S if name == "due_s" else 0.0
        widths = [(0, unused)] + [(0, 0)] * (each.ndim - 1)
        return jnp.asarray(np.pad(each, widths, constant_values=empty), dtype=jnp.float32)

    candidates = Candidates(
        route=jnp.asarray(np.pad(route, (0, unused)), dtype=jnp.int32),
        **{name: padded(name, each) for name, each in values.items()},
    )
    return state._replace(arrivals=state.arrivals._replace(candidates=candidates))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Fly recorded hours again, and compare.")
    parser.add_argument("folder", type=Path, help="a folder with the tables of hours")
    folder = parser.parse_args(arguments).folder
    path, console, found = folder / "episodes.parquet", Console(width=100), []
    try:
        episodes = read_table(path, ("scenario",))
        sector = sector_of(path, episodes)
        for number in episodes["scenario"].to_pylist():
            found.append(agreement(sector, read_hour(folder, number)))
            console.print(f"hour {number}: {in_words(found[-1])}")
    except InputError as error:
        Console(stderr=True).print(str(error), markup=False)
        return 2
    total = Agreement(*map(sum, zip(*found, strict=True)))
    worst_nm = max(each.worst_nm for each in found)
    console.print(f"{len(found)} hours: {in_words(total._replace(worst_nm=worst_nm))}")
    return int(worst_nm > BOUND_NM or total.wrong_levels + total.wrong_exits > 0)


def in_words(found: Agreement) -> str:
    return (
        f"{found.flights:,} flights, {found.rows:,} positions, at most {found.worst_nm:.4f} NM "
        f"apart; more than {BOUND_NM} NM apart: {found.far_rows} positions of "
        f"{found.far_flights} flights; at a different level: {found.wrong_levels} positions; "
        f"leaving in a different cycle: {found.wrong_exits} flights"
    )


if __name__ == "__main__":
    sys.exit(main())
