"""What happened, as four tables: episodes, aircraft, trajectories, clearances."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import jax
import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from skystack.evaluation.followed import STATUS, status_of
from skystack.evaluation.rollout import Recording
from skystack.platforms.adoption import SKYSTACK, Adoption, in_words
from skystack.platforms.instruction import Instruction
from skystack.platforms.phraseology import written
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S
from skystack.simulator.traffic import Traffic, callsigns, trajectory_columns
from skystack.tasks.navigation import NavigationTask
from skystack.tasks.rewards import MAX_INSTRUCTIONS


@dataclass(frozen=True)
class Tables:
    """The four tables of an evaluation."""

    episodes: pa.Table
    aircraft: pa.Table
    trajectories: pa.Table
    clearances: pa.Table


def make_tables(
    task: NavigationTask,
    recording: Recording,
    flown_as: Callable[[str], str] = str,
    adoption: Adoption = SKYSTACK,
) -> Tables:
    """All four tables of what was flown, as a platform flies types and adopts clearances."""
    return Tables(
        episodes=episode_table(task, recording),
        aircraft=_aircraft_table(task, recording, flown_as),
        trajectories=_trajectory_table(task, recording),
        clearances=clearance_table(task, recording, adoption),
    )


def episode_table(task: NavigationTask, recording: Recording) -> pa.Table:
    """One row a scenario. The count criterion counts clearances here, not instructions."""
    metrics = recording.metrics
    issued = clearances_by_aircraft(task, recording)
    few = np.all(issued < MAX_INSTRUCTIONS, axis=1)
    success = metrics.correct_exit & ~metrics.excursion
    if task.settings.reward.count_criterion:
        success = success & few
    return pa.table(
        {
            "scenario": recording.number,
            "clearances": issued.sum(axis=1).astype(np.int32),
            "instructions": recording.instructions.sum(axis=1).astype(np.int32),
            "return": recording.reward.sum(axis=1),
            "success": success,
            "correct_exit": metrics.correct_exit,
            "excursion": metrics.excursion,
            "few_clearances": few,
            "min_separation_nm": metrics.min_separation_nm,
            "loss_of_separation": metrics.min_separation_nm < task.sector.loss_below_nm,
            "cycles": recording.ran.sum(axis=1).astype(np.int32),
        }
    )


def clearances_by_aircraft(
    task: NavigationTask, recording: Recording
) -> Int[np.ndarray, "scenarios aircraft"]:
    """How many clearances each aircraft was given."""
    addressed = np.array([-1, *(aircraft for aircraft, _ in task.actions.changes)])
    who = np.where(recording.instructions > 0, addressed[recording.action], -1)
    numbers = np.arange(task.scenarios.aircraft)
    return (who[:, :, None] == numbers).sum(axis=1)


def _aircraft_table(
    task: NavigationTask, recording: Recording, flown_as: Callable[[str], str]
) -> pa.Table:
    scenarios, count = recording.start.level_ticks.shape
    routes = [" ".join(route) for route in task.simulator.sector.routes]
    types = np.array([flown_as(each) for each in task.simulator.performance.types])
    return pa.table(
        {
            "scenario": np.repeat(recording.number, count),
            "callsign": _repeated(callsigns(task.scenarios.aircraft), scenarios),
            "type": pa.array(types[np.asarray(recording.start.kind).reshape(-1)]),
            "route": pa.array(np.array(routes)[recording.start.route.reshape(-1)]),
            "entry_fl": _flight_levels(recording.start.level_ticks).reshape(-1),
            "exit_fl": _flight_levels(recording.exit_level_ticks).reshape(-1),
            "own_navigation": np.asarray(recording.start.own_navigation).reshape(-1),
        }
    )


def _trajectory_table(task: NavigationTask, recording: Recording) -> pa.Table:
    """One row per aircraft and cycle until the scenario's end; row 0 is the start."""
    traffic: Traffic = jax.tree.map(
        lambda start, later: np.concatenate([start[:, None], later], axis=1),
        recording.start,
        recording.traffic,
    )
    status = _status(recording)
    scenarios = status.shape[0]
    shown = np.concatenate([np.ones((scenarios, 1), dtype=bool), recording.ran], axis=1)
    keep = np.broadcast_to(shown[:, :, None], status.shape).reshape(-1)
    scenario, cycle, who = (index.reshape(-1)[keep] for index in np.indices(status.shape))
    columns = trajectory_columns(traffic, task.simulator.sector.plane)
    return pa.table(
        {
            "scenario": recording.number[scenario],
            "cycle": cycle.astype(np.int32),
            "time_s": (cycle * CYCLE_S).astype(np.int32),
            "callsign": pa.DictionaryArray.from_arrays(
                who.astype(np.int32), callsigns(task.scenarios.aircraft)
            ),
            **{name: _stored(name, values.reshape(-1)[keep]) for name, values in columns.items()},
            "status": pa.DictionaryArray.from_arrays(status.reshape(-1)[keep], list(STATUS)),
        }
    )


def _stored(name: str, values: Float[np.ndarray, " rows"]) -> np.ndarray:
    """Degrees of position to 1 cm, so that separations can be measured again; all else float32."""
    return values.round(7) if name in ("lat", "lon") else values.astype(np.float32)


def _status(recording: Recording) -> Int[np.ndarray, "scenarios rows aircraft"]:
    """Index in STATUS; at the start nobody has entered."""
    status = status_of(recording.entered, recording.exited, recording.excursion)
    return np.concatenate([np.zeros_like(status[:, :1]), status], axis=1)


def clearance_table(
    task: NavigationTask, recording: Recording, adoption: Adoption = SKYSTACK
) -> pa.Table:
    """One row a clearance, in the order issued."""
    scenario, cycle = np.nonzero(recording.instructions > 0)
    who = np.array([(-1, 0), *task.actions.changes])[recording.action[scenario, cycle]][:, 0]
    at, kind, signs = (scenario, cycle, who), task.actions.kind, callsigns(task.scenarios.aircraft)
    if kind == "level":
        value = _flight_levels(np.asarray(recording.traffic.cleared_level_ticks)[at])
        commands = [Instruction(signs[a], level_fl=v) for a, v in _pairs(who, value)]
    else:
        value = np.rint(np.asarray(recording.traffic.cleared_heading_deg)[at]).astype(np.int32)
        commands = [Instruction(signs[a], heading_deg=v) for a, v in _pairs(who, value)]
    heading_deg, level = (_when_adopted(recording, name, adoption)[at] for name in _STATE)
    issued = in_words(commands, heading_deg, level / TICKS_PER_FL, adoption)
    direction = [each.turn or each.vertical for each in issued]
    return pa.table(
        {
            "scenario": recording.number[scenario],
            "cycle": cycle.astype(np.int32),
            "transmission": _running_number(scenario),
            "callsign": pa.DictionaryArray.from_arrays(who.astype(np.int32), signs),
            "kind": pa.array([kind] * len(who), type=pa.string()),
            "value": value,
            "direction": pa.array(direction, type=pa.string()),
            "instructions": recording.instructions[scenario, cycle].astype(np.int32),
            "text": pa.array([written(each) for each in issued], type=pa.string()),
        }
    )


_STATE = ("heading_deg", "level_ticks")


def _when_adopted(recording: Recording, name: str, adoption: Adoption) -> np.ndarray:
    """A field of the traffic when the clearances of each cycle were adopted."""
    after = np.asarray(getattr(recording.traffic, name))
    return after if adoption.cycles else recording.before(name)


def _pairs(who: Int[np.ndarray, " n"], value: Int[np.ndarray, " n"]) -> Iterator[tuple[int, int]]:
    return zip(who.tolist(), value.tolist(), strict=True)


def _flight_levels(ticks: ArrayLike) -> Int[np.ndarray, "*n"]:
    return np.rint(np.asarray(ticks) / TICKS_PER_FL).astype(np.int32)


def _running_number(scenario: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """0, 1, 2, ... within each scenario (sorted by it)."""
    first = np.searchsorted(scenario, scenario, side="left")
    return (np.arange(len(scenario)) - first).astype(np.int32)


def _repeated(values: Sequence[str], times: int) -> pa.Array:
    return pa.array(list(values) * times)
