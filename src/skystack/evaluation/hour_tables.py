"""The tables of flown hours, in the form of the tables of an evaluation of scenarios.

Each hour is a scenario. `aircraft` has one row per flight, and trajectories begin in the cycle of
birth (`birth_cycle`), so not in row 0. `losses` has the pairs of flights that lost separation.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pyarrow as pa

from skystack.agents.callsigns import Callsigns
from skystack.agents.transmission import instruction_of
from skystack.evaluation.followed import STATUS, status_of
from skystack.evaluation.hour_row import ROW_FILE
from skystack.evaluation.hour_scores import FlightRow, PairEvent, Scores
from skystack.evaluation.hours import Hour
from skystack.evaluation.tables import clearance_rows, rounded
from skystack.evaluation.writing import TrafficRecord, growing_tables, table_metadata
from skystack.io.json_file import finite
from skystack.io.locks import locked_folder
from skystack.platforms.adoption import SKYSTACK, in_words
from skystack.simulator.arrivals import FREE
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S
from skystack.simulator.traffic import trajectory_columns
from skystack.tasks.sector_world import World

TABLES = ("episodes", "aircraft", "trajectories", "clearances", "losses")

AppendHour = Callable[[Hour, Scores], None]


@dataclass(frozen=True)
class FlownHour:
    """An hour in its world."""

    world: World
    hour: Hour
    scores: Scores

    @cached_property
    def callsigns(self) -> list[str]:
        """The callsigns of all flights, in order of birth."""
        return callsigns_of(self.hour, self.world.flow.callsigns)


@contextmanager
def growing_hours(
    folder: Path, world: World, performance: str, traffic: TrafficRecord
) -> Iterator[AppendHour]:
    """Tables in a folder, to which the body appends hour by hour.

    At the end, they all replace the folder's tables together, and the folder's row is deleted.
    Raises InputError for a folder that cannot be written to or is in use by another process.
    """
    metadata = table_metadata(world.sector, performance, traffic=traffic)
    row = [folder / ROW_FILE]
    with locked_folder(folder), growing_tables(folder, TABLES, metadata, outdated=row) as append:

        def append_hour(hour: Hour, scores: Scores) -> None:
            append(tables_of(FlownHour(world, hour, scores)))

        yield append_hour


def tables_of(flown: FlownHour) -> dict[str, pa.Table]:
    """The tables of one hour, by name."""
    clearances = _clearances(flown)
    return {
        "episodes": _episode(flown, clearances.num_rows),
        "aircraft": _aircraft(flown),
        "trajectories": _trajectories(flown),
        "clearances": clearances,
        "losses": _losses(flown),
    }


def _episode(flown: FlownHour, clearances: int) -> pa.Table:
    scores = flown.scores
    gone = [row for row in scores.flights if row.gone is not None]
    row = {
        "scenario": scores.number,
        "cycles": len(flown.hour.flight),
        "clearances": clearances,
        "transmissions": len(flown.hour.sent),
        "flights": len(scores.flights),
        "flights_gone": len(gone),
        "correct_exits": sum(each.correct for each in gone),
        "excursions": sum(each.excursion for each in gone),
        "losses_of_separation": len(scores.losses),
        "losses_at_birth": sum(each.at_birth for each in scores.losses),
        "lax_s": scores.lax_s,
        "lax_without_births_s": scores.lax_without_births_s,
        "strict_s": scores.strict_s,
    }
    return pa.Table.from_pylist([row])


_AIRCRAFT = pa.schema(
    [
        ("scenario", pa.int64()),
        ("callsign", pa.string()),
        ("type", pa.string()),
        ("route", pa.string()),
        ("entry_fl", pa.float32()),
        ("exit_fl", pa.int32()),
        ("own_navigation", pa.bool_()),
        ("birth_cycle", pa.int32()),
        ("entry_cycle", pa.int32()),
        ("gone_cycle", pa.int32()),
        ("exited", pa.bool_()),
        ("correct_exit", pa.bool_()),
        ("excursion", pa.bool_()),
        ("exit_offset_nm", pa.float32()),
        ("flown_nm", pa.float32()),
        ("extra_nm", pa.float32()),
        ("delay_s", pa.float32()),
        ("level_offs", pa.int32()),
        ("transmissions", pa.int32()),
    ]
)


def _aircraft(flown: FlownHour) -> pa.Table:
    rows = [_aircraft_row(flown, each) for each in flown.scores.flights]
    return pa.Table.from_pylist(rows, schema=_AIRCRAFT)


def _aircraft_row(flown: FlownHour, row: FlightRow) -> dict[str, Any]:
    """Cycles are rows of the trajectories: row k of an hour is the state after cycle k + 1."""
    hour, simulator = flown.hour, flown.world.simulator
    slot = int(np.flatnonzero(hour.flight[row.birth] == row.flight)[0])
    at = (row.birth, slot)
    entered = np.flatnonzero(hour.entered[:, slot] & (hour.flight[:, slot] == row.flight))
    return {
        "scenario": hour.number,
        "callsign": flown.callsigns[row.flight],
        "type": simulator.performance.types[int(hour.traffic.kind[at])],
        "route": " ".join(simulator.sector.routes[int(hour.traffic.route[at])]),
        "entry_fl": float(hour.before_level_ticks[at]) / TICKS_PER_FL,
        "exit_fl": round(float(hour.exit_level_ticks[at]) / TICKS_PER_FL),
        "own_navigation": bool(hour.traffic.own_navigation[at]),
        "birth_cycle": row.birth + 1,
        "entry_cycle": int(entered[0]) + 1 if len(entered) else None,
        "gone_cycle": None if row.gone is None else row.gone + 1,
        "exited": row.exited,
        "correct_exit": row.correct,
        "excursion": row.excursion,
        **{
            name: finite(getattr(row, name))
            for name in ("exit_offset_nm", "flown_nm", "extra_nm", "delay_s")
        },
        "level_offs": row.level_offs,
        "transmissions": row.transmissions,
    }


def _trajectories(flown: FlownHour) -> pa.Table:
    """One row per flight and cycle, from the cycle of birth to that in which the flight leaves."""
    hour = flown.hour
    present = hour.flight != FREE
    cycle, _ = np.nonzero(present)
    traffic = jax.tree.map(lambda values: values[present], hour.traffic)
    columns = trajectory_columns(traffic, flown.world.sector.plane)
    status = status_of(hour.entered, hour.exited, hour.excursion)[present]
    return pa.table(
        {
            "scenario": np.full(len(cycle), hour.number),
            "cycle": (cycle + 1).astype(np.int32),
            "time_s": ((cycle + 1) * CYCLE_S).astype(np.int32),
            "callsign": pa.DictionaryArray.from_arrays(
                hour.flight[present].astype(np.int32), pa.array(flown.callsigns, pa.string())
            ),
            **{name: rounded(name, values) for name, values in columns.items()},
            "status": pa.array(np.array(STATUS)[status], pa.string()),
        }
    )


def _clearances(flown: FlownHour) -> pa.Table:
    """One row per clearance; a heading or fix with a level gives two rows of one transmission."""
    hour, routes = flown.hour, flown.world.sector.routes
    cycle = np.array([each.cycle for each in hour.sent], dtype=np.int64)
    slot = np.array([each.transmission.slot for each in hour.sent], dtype=np.int64)
    commands, planned = [], []
    for each in hour.sent:
        told = each.transmission
        planned.append(routes[int(hour.traffic.route[each.cycle, told.slot])])
        commands.append(instruction_of(told, flown.callsigns[each.flight], planned[-1]))
    at = (cycle, slot)
    heading_deg, level_ticks = (
        np.asarray(each)[at] for each in (hour.traffic.heading_deg, hour.traffic.level_ticks)
    )
    issued = in_words(commands, heading_deg, level_ticks / TICKS_PER_FL, SKYSTACK)
    rows = [
        {"scenario": hour.number, "transmission": number, **row}
        for number, (each, words, route) in enumerate(zip(hour.sent, issued, planned, strict=True))
        for row in clearance_rows(each.cycle, words, route, each.transmission.instructions)
    ]
    return pa.Table.from_pylist(rows, schema=_CLEARANCES)


_CLEARANCES = pa.schema(
    [
        ("scenario", pa.int64()),
        ("cycle", pa.int32()),
        ("transmission", pa.int32()),
        ("callsign", pa.string()),
        ("kind", pa.string()),
        ("value", pa.int32()),
        ("direction", pa.string()),
        ("instructions", pa.int32()),
        ("text", pa.string()),
    ]
)


_LOSSES = pa.schema(
    [
        ("scenario", pa.int64()),
        ("cycle", pa.int32()),
        ("first", pa.string()),
        ("second", pa.string()),
        ("at_birth", pa.bool_()),
        ("inside_cycle", pa.int32()),
    ]
)


def _losses(flown: FlownHour) -> pa.Table:
    rows = [_loss(flown, each) for each in flown.scores.losses]
    return pa.Table.from_pylist(rows, schema=_LOSSES)


def _loss(flown: FlownHour, loss: PairEvent) -> dict[str, Any]:
    return {
        "scenario": flown.hour.number,
        "cycle": loss.cycle + 1,
        "first": flown.callsigns[loss.first],
        "second": flown.callsigns[loss.second],
        "at_birth": loss.at_birth,
        "inside_cycle": None if loss.inside_cycle is None else loss.inside_cycle + 1,
    }


def callsigns_of(hour: Hour, own: Sequence[str] = ()) -> list[str]:
    """The callsigns of all flights, in order of birth; `own` are those of the candidates."""
    flight, first = np.unique(hour.flight, return_index=True)
    candidates, names = hour.candidate.reshape(-1)[first[flight != FREE]], Callsigns(own)
    return [names.add(candidate) for candidate in candidates.tolist()]
