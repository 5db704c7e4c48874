"""Hours recorded in another simulator: their tables, and their births in our simulator."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Array, Float

from skystack.agents.transmission import Transmission
from skystack.airspace.sector import Sector
from skystack.errors import InputError
from skystack.evaluation.foreign_hours import writable
from skystack.evaluation.hours import OwnHours
from skystack.evaluation.stored import read_table
from skystack.simulator.arrival_flows import Flow
from skystack.simulator.arrivals import FREE, Arrivals, Candidates, Clock
from skystack.simulator.performance import ConstantPerformance, performance
from skystack.simulator.simulator import CYCLE_S, Simulator
from skystack.simulator.traffic import ticks
from skystack.tasks.sector_world import World, WorldCycle, WorldState

MOST_FLIGHTS = 1024
NEVER_S = 1e9
"""The time of birth of candidates that are not used."""


class Track(NamedTuple):
    """A recorded flight. Arrays are `[rows]`, one row for each cycle in which it flew."""

    route: tuple[str, ...]
    exit_fl: float
    cycle: np.ndarray
    lat: np.ndarray
    """Degrees, like `lon`."""
    lon: np.ndarray
    fl: np.ndarray
    heading_deg: np.ndarray
    speed_kt: float
    """The ground speed at birth. In level flight, it is the true airspeed."""
    starts: bool
    """Whether it is there from the start."""
    gone_cycle: int | None
    birth_cycle: int
    """The first cycle in which it was reported."""


class Recorded(NamedTuple):
    """A recorded hour."""

    tracks: list[Track]
    sent: dict[int, list[tuple[int, Transmission]]]
    """Transmissions by cycle, each with the index of its track. Their `slot` is not used."""
    cycles: int


def read_hour(folder: Path, number: int) -> Recorded:
    """Read an hour from the tables of an evaluation. Raises InputError if they are damaged."""
    of_hour = [("scenario", "=", number)]
    episodes = read_table(folder / "episodes.parquet", ("cycles",), of_hour)
    if not episodes.num_rows:
        raise InputError(f"{folder}: has no hour {number}")
    names = ("callsign", "route", "exit_fl", "gone_cycle")
    flights = read_table(folder / "aircraft.parquet", names, of_hour).to_pylist()
    columns = ("callsign", "cycle", "lat", "lon", "fl", "heading_deg", "ground_speed_kt")
    rows = _by_callsign(read_table(folder / "trajectories.parquet", columns, of_hour))
    if missing := [each["callsign"] for each in flights if each["callsign"] not in rows]:
        raise InputError(f"{folder}: hour {number}: {missing[0]} has no trajectory")
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
        birth_cycle=int(values["cycle"][0]),
    )


def row_of(track: Track, cycle: int) -> int | None:
    """The row of a track after a number of cycles; None if it has none."""
    row = cycle - int(track.cycle[0])
    return row if 0 <= row < len(track.cycle) else None


def distance_nm(
    sector: Sector, track: Track, row: int, position_nm: Float[np.ndarray, "2"]
) -> float:
    """The distance of a position in the plane from a row of a track."""
    there = sector.plane.to_plane(track.lat[row], track.lon[row])
    return float(np.hypot(*(position_nm - there)) / sector.plane.scale(there[1:])[0])


class RecordedHours:
    """Implements `skystack.evaluation.hours.Hours` in our simulator, with recorded births.

    Flights are held at their positions of birth for as many cycles as in the recording, and hear no
    clearances while they are held.
    """

    def __init__(self, sector: Sector, slots: int, hour: Recorded) -> None:
        """Raises InputError if the hour has no flights, or too many."""
        if not 0 < len(hour.tracks) <= MOST_FLIGHTS:
            raise InputError(f"{len(hour.tracks)} flights (allowed: 1 to {MOST_FLIGHTS})")
        self.order = sorted(range(len(hour.tracks)), key=lambda at: hour.tracks[at].birth_cycle)
        """The indices of the tracks in order of birth: flight k has track `order[k]`."""
        tracks = [hour.tracks[index] for index in self.order]
        simulator = Simulator(sector, performance("constant"), own_navigation=True)
        flow = Flow(simulator, Clock(0.0, recorded=True), slots, hour.cycles, MOST_FLIGHTS)
        self.world = World(flow)
        self._own = OwnHours(self.world)
        self._candidates = _candidates(self.world, tracks)
        self._last_held = np.array([0 if each.starts else int(each.cycle[0]) for each in tracks])

    def reset(self, seed: int, number: int) -> WorldState:
        """Begin the hour; seed and number are not used."""
        state = self._own.reset(seed, number)
        state = state._replace(arrivals=state.arrivals._replace(candidates=self._candidates))
        # Births take effect at the end of a cycle, so a cycle is flown first.
        state, _ = self._own.advance(state, [])
        return self._held(state, 0)

    def advance(
        self, state: WorldState, transmissions: list[Transmission]
    ) -> tuple[WorldState, WorldCycle]:
        state, cycle = self._own.advance(state, transmissions)
        return self._held(state, int(state.arrivals.cycle)), cycle

    def close(self) -> None:
        self._own.close()

    def _held(self, state: WorldState, cycle: int) -> WorldState:
        """The state after a cycle, with newborns held for as long as in the recording."""
        flight = np.asarray(state.arrivals.flight)
        left = np.where(flight == FREE, 0, self._last_held[flight] - cycle)
        values = writable(state.arrivals)
        values["cycle"] = np.int32(cycle)
        values["held"][:] = np.maximum(left, 0)
        return state._replace(arrivals=Arrivals(**values))


def _candidates(world: World, tracks: Sequence[Track]) -> Candidates:
    """The flights of recorded tracks, in order of birth.

    Starters are recorded only after their first cycle, in which they fly straight on, so they are
    put back by the distance of one cycle.
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
        "due_s": CYCLE_S * np.array([each.birth_cycle - 1 for each in tracks]),
        "position_nm": position - np.where(starts, flown_nm, 0.0)[:, None] * back,
        "heading_deg": heading,
        "entry_level_ticks": np.array([ticks(float(each.fl[0])) for each in tracks]),
        "exit_level_ticks": np.array([ticks(each.exit_fl) for each in tracks]),
        "airspeed_factor": speed_kt / model.airspeed_kt,
        "climb_factor": np.ones(len(tracks)),
    }
    route = np.array([routes[each.route] for each in tracks])
    unused = MOST_FLIGHTS - len(tracks)

    def padded(name: str, each: np.ndarray) -> Array:
        empty = NEVER_S if name == "due_s" else 0.0
        widths = [(0, unused)] + [(0, 0)] * (each.ndim - 1)
        return jnp.asarray(np.pad(each, widths, constant_values=empty), dtype=jnp.float32)

    return Candidates(
        route=jnp.asarray(np.pad(route, (0, unused)), dtype=jnp.int32),
        **{name: padded(name, each) for name, each in values.items()},
    )
