"""The four tables of an evaluation: episodes, aircraft, trajectories, clearances."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from skystack.evaluation.exit_offset import exit_offsets_nm
from skystack.evaluation.followed import STATUS, status_of
from skystack.evaluation.rollout import Recording
from skystack.platforms.adoption import SKYSTACK, Adoption, in_words
from skystack.platforms.instruction import Instruction
from skystack.platforms.phraseology import written
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S
from skystack.simulator.traffic import Traffic, callsigns, trajectory_columns
from skystack.tasks.contract import TrafficTask
from skystack.tasks.rewards import MAX_INSTRUCTIONS


@dataclass(frozen=True)
class Tables:
    """The four tables of an evaluation."""

    episodes: pa.Table
    aircraft: pa.Table
    trajectories: pa.Table
    clearances: pa.Table


def make_tables(
    task: TrafficTask,
    recording: Recording,
    flown_as: Callable[[str], str] = str,
    adoption: Adoption = SKYSTACK,
) -> Tables:
    """All four tables of a recording. `flown_as` and `adoption` are those of the platform."""
    offsets_nm = exit_offsets_nm(task.sector, recording)
    return Tables(
        episodes=episode_table(task, recording, offsets_nm),
        aircraft=_aircraft_table(task, recording, flown_as, offsets_nm),
        trajectories=_trajectory_table(task, recording),
        clearances=clearance_table(task, recording, adoption),
    )


def episode_table(
    task: TrafficTask, recording: Recording, offsets_nm: Float[np.ndarray, "scenarios aircraft"]
) -> pa.Table:
    """One row per scenario. The limit on instructions is applied to clearances here.

    `offsets_nm` are the exit offsets of the recording. `exits` counts the aircraft that left
    through their exit, at any level, without landings, and `exit_offset_nm` is their mean distance
    from the exit fix. The task's other metrics follow as additional columns.
    """
    metrics = recording.metrics
    issued = clearances_by_aircraft(task, recording)
    exits = np.isfinite(offsets_nm).sum(axis=1)
    with np.errstate(invalid="ignore"):
        mean_offset_nm = np.nansum(offsets_nm, axis=1) / exits
    columns = {
        "scenario": recording.number,
        "clearances": issued.sum(axis=1).astype(np.int32),
        "instructions": recording.instructions.sum(axis=1).astype(np.int32),
        "return": recording.reward.sum(axis=1),
        "success": task.succeeded(metrics, issued),
        "correct_exit": metrics["correct_exit"],
        "excursion": metrics["excursion"],
        "few_clearances": np.all(issued < MAX_INSTRUCTIONS, axis=1),
        "min_separation_nm": metrics["min_separation_nm"],
        "loss_of_separation": metrics["min_separation_nm"] < task.sector.loss_below_nm,
        "cycles": recording.ran.sum(axis=1).astype(np.int32),
        "exits": exits.astype(np.int32),
        "exit_offset_nm": _null_for_nan(mean_offset_nm),
    }
    others = {name: metrics[name] for name in sorted(metrics) if name not in columns}
    return pa.table(columns | others)


def clearances_by_aircraft(
    task: TrafficTask, recording: Recording
) -> Int[np.ndarray, "scenarios aircraft"]:
    """The number of clearances issued to each aircraft."""
    addressed = np.where(recording.instructions > 0, _addressed(task)[recording.action], -1)
    numbers = np.arange(task.aircraft)
    return (addressed[:, :, None] == numbers).sum(axis=1)


def _aircraft_table(
    task: TrafficTask,
    recording: Recording,
    flown_as: Callable[[str], str],
    offsets_nm: Float[np.ndarray, "scenarios aircraft"],
) -> pa.Table:
    scenarios, count = recording.start.level_ticks.shape
    routes = [" ".join(route) for route in task.sector.routes]
    types = np.array([flown_as(each) for each in task.simulator.performance.types])
    return pa.table(
        {
            "scenario": np.repeat(recording.number, count),
            "callsign": _repeated(callsigns(task.aircraft), scenarios),
            "type": pa.array(types[np.asarray(recording.start.kind).reshape(-1)]),
            "route": pa.array(np.array(routes)[recording.start.route.reshape(-1)]),
            "entry_fl": _flight_levels(recording.start.level_ticks).reshape(-1),
            "exit_fl": _flight_levels(recording.exit_level_ticks).reshape(-1),
            "own_navigation": np.asarray(recording.start.own_navigation).reshape(-1),
            "exit_offset_nm": _null_for_nan(offsets_nm.reshape(-1)),
        }
    )


def _null_for_nan(values: Float[np.ndarray, " rows"]) -> pa.Array:
    return pa.array(values.astype(np.float32), from_pandas=True)


def _trajectory_table(task: TrafficTask, recording: Recording) -> pa.Table:
    """One row per aircraft and cycle until the scenario's end; row 0 is the start."""
    traffic: Traffic = jax.tree.map(
        lambda start, later: np.concatenate([start[:, None], later], axis=1),
        recording.start,
        recording.traffic,
    )
    status = _status(recording)
    scenarios = status.shape[0]
    flown = np.concatenate([np.ones((scenarios, 1), dtype=bool), recording.ran], axis=1)
    keep = np.broadcast_to(flown[:, :, None], status.shape).reshape(-1)
    scenario, cycle, aircraft = (index.reshape(-1)[keep] for index in np.indices(status.shape))
    columns = trajectory_columns(traffic, task.sector.plane)
    return pa.table(
        {
            "scenario": recording.number[scenario],
            "cycle": cycle.astype(np.int32),
            "time_s": (cycle * CYCLE_S).astype(np.int32),
            "callsign": pa.DictionaryArray.from_arrays(
                aircraft.astype(np.int32), callsigns(task.aircraft)
            ),
            **{name: rounded(name, values.reshape(-1)[keep]) for name, values in columns.items()},
            "status": pa.DictionaryArray.from_arrays(status.reshape(-1)[keep], list(STATUS)),
        }
    )


def rounded(name: str, values: Float[np.ndarray, " rows"]) -> np.ndarray:
    """Positions rounded to 1 cm, so that separations can be recomputed; other values as float32."""
    return values.round(7) if name in ("lat", "lon") else values.astype(np.float32)


def _status(recording: Recording) -> Int[np.ndarray, "scenarios rows aircraft"]:
    """Index in STATUS; row 0 is the start."""
    start, later = status_of(*recording.start_status), status_of(*recording.status)
    return np.concatenate([start[:, None], later], axis=1)


def clearance_table(
    task: TrafficTask, recording: Recording, adoption: Adoption = SKYSTACK
) -> pa.Table:
    """One row per clearance, in the order issued."""
    scenario, cycle = np.nonzero(recording.instructions > 0)
    action = recording.action[scenario, cycle]
    aircraft = _addressed(task)[action]
    kinds = [task.actions[each].kind for each in action.tolist()]
    at, signs = (scenario, cycle, aircraft), callsigns(task.aircraft)
    is_level = np.array([kind == "level" for kind in kinds], dtype=bool)
    value = np.where(
        is_level,
        _flight_levels(np.asarray(recording.traffic.cleared_level_ticks)[at]),
        np.rint(np.asarray(recording.traffic.cleared_heading_deg)[at]).astype(np.int32),
    )
    commands = [
        Instruction(signs[a], level_fl=v) if level else Instruction(signs[a], heading_deg=v)
        for a, v, level in zip(aircraft.tolist(), value.tolist(), is_level.tolist(), strict=True)
    ]
    names = ("heading_deg", "level_ticks")
    heading_deg, level = (_when_adopted(recording, name, adoption)[at] for name in names)
    issued = in_words(commands, heading_deg, level / TICKS_PER_FL, adoption)
    direction = [each.turn or each.vertical for each in issued]
    return pa.table(
        {
            "scenario": recording.number[scenario],
            "cycle": cycle.astype(np.int32),
            "transmission": _running_number(scenario),
            "callsign": pa.DictionaryArray.from_arrays(aircraft.astype(np.int32), signs),
            "kind": pa.array(kinds, type=pa.string()),
            "value": value,
            "direction": pa.array(direction, type=pa.string()),
            "instructions": recording.instructions[scenario, cycle].astype(np.int32),
            "text": pa.array([written(each) for each in issued], type=pa.string()),
        }
    )


def clearance_rows(
    cycle: int, issued: Instruction, route: Sequence[str], instructions: int = 1
) -> list[dict[str, Any]]:
    """The rows of one transmission: a heading or a fix with a level gives two.

    The value of a clearance direct to a fix is the fix's index in the route.
    """
    fix = None if issued.direct_to is None else list(route).index(issued.direct_to)
    parts = (
        ("heading", issued.heading_deg, issued.turn),
        ("direct", fix, None),
        ("level", issued.level_fl, issued.vertical),
    )
    return [
        {
            "cycle": cycle,
            "callsign": issued.callsign,
            "kind": kind,
            "value": value,
            "direction": direction,
            "instructions": instructions,
            "text": written(issued),
        }
        for kind, value, direction in parts
        if value is not None
    ]


def _when_adopted(recording: Recording, name: str, adoption: Adoption) -> np.ndarray:
    """A field of the traffic when the clearances of each cycle were adopted."""
    after = np.asarray(getattr(recording.traffic, name))
    return after if adoption.cycles else recording.before(name)


def _addressed(task: TrafficTask) -> Int[np.ndarray, " actions"]:
    """The index of the aircraft that each action addresses; -1 for none."""
    return np.array([-1 if each.aircraft is None else each.aircraft for each in task.actions])


def _flight_levels(ticks: ArrayLike) -> Int[np.ndarray, "*n"]:
    return np.rint(np.asarray(ticks) / TICKS_PER_FL).astype(np.int32)


def _running_number(scenario: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """0, 1, 2, ... within each scenario; `scenario` is sorted."""
    first = np.searchsorted(scenario, scenario, side="left")
    return (np.arange(len(scenario)) - first).astype(np.int32)


def _repeated(values: Sequence[str], times: int) -> pa.Array:
    return pa.array(list(values) * times)
