"""Score flown hours: separation, exits, transmissions, efficiency and survival.

*At birth*: a loss of separation that exists when the younger of the two flights first moves. It is
then too late to instruct this flight. The scores are times to the first failure: the lax score ends
with an excursion or a loss inside the sector, the strict one also with an incorrect exit.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from skystack.airspace.landing import LANDING_NM
from skystack.airspace.sector import Sector
from skystack.evaluation.exit_offset import crossing_nm, distance_to_exit_nm
from skystack.evaluation.hours import Hour
from skystack.evaluation.losses import compiled_squared_nm2
from skystack.simulator.arrivals import FREE
from skystack.simulator.simulator import CYCLE_S

CLOSE_NM = 7.0
"""Two flights closer than this, without vertical separation, are a close pair."""
BIRTH, LOSS, EXCURSION, WRONG_EXIT = "loss at birth", "loss", "excursion", "wrong exit level"
CAUSES = (BIRTH, LOSS, EXCURSION, WRONG_EXIT)
"""What ends the scores; the last one ends only the strict score."""
MINUTE_CYCLES = 60 // CYCLE_S
_CYCLES = 100
"""The cycles whose pairs are computed at once."""


class PairEvent(NamedTuple):
    """Two flights that came close without vertical separation. Cycles are rows of the hour."""

    cycle: int
    """The first cycle in which they were too close."""
    first: int
    second: int
    """The younger flight."""
    at_birth: bool
    inside_cycle: int | None
    """The first cycle in which they were too close after both had entered the sector."""


class FlightRow(NamedTuple):
    """What happened to one flight. Cycles are rows of the hour."""

    flight: int
    birth: int
    """The cycle in which it was born."""
    gone: int | None
    """The cycle in which it left; None if it had not left at the end."""
    exited: bool
    correct: bool
    excursion: bool
    exit_offset_nm: float
    """Distance from the exit fix when it crossed its exit; NaN if it did not, or landed."""
    flown_nm: float
    extra_nm: float
    """Distance flown beyond the length of its route; NaN unless it exited."""
    delay_s: float
    """The time that the extra distance takes."""
    level_offs: int
    """The number of times it stopped climbing or descending at a level other than its exit's."""
    transmissions: int


class CycleSeries(NamedTuple):
    """What a summary needs of each cycle of an hour."""

    transmissions: Int[np.ndarray, " cycles"]
    """The number issued before the cycle."""
    aircraft: Int[np.ndarray, " cycles"]
    waiting: Int[np.ndarray, " cycles"]
    fail_safe: Bool[np.ndarray, " cycles"]
    decision_ms: Float[np.ndarray, " cycles"]


class Scores(NamedTuple):
    """The scores of one hour."""

    number: int
    """The number of the hour under the evaluation seed."""
    cycles: CycleSeries
    flights: list[FlightRow]
    losses: list[PairEvent]
    close_pairs: list[PairEvent]
    lax_s: float
    lax_without_births_s: float
    strict_s: float
    lax_ended_by: str | None
    """The first of `CAUSES` that ended the lax score; None if nothing did."""
    strict_ended_by: str | None


def score(sector: Sector, hour: Hour) -> Scores:
    """Score an hour."""
    below_nm = sector.loss_below_nm
    approaches = _approaches(sector, hour, max(below_nm, CLOSE_NM))
    moved = _first_moves(hour)
    losses = _pair_events(hour, approaches, below_nm, moved)
    first = {
        BIRTH: _inside_cycle(each for each in losses if each.at_birth),
        LOSS: _inside_cycle(each for each in losses if not each.at_birth),
        EXCURSION: _cycle(np.any(hour.excursion, axis=1)),
        WRONG_EXIT: _cycle(np.any(hour.exited & ~hour.exited_correctly, axis=1)),
    }
    lax = _ended(first, (BIRTH, LOSS, EXCURSION))
    strict = _ended(first, CAUSES)
    return Scores(
        number=hour.number,
        cycles=CycleSeries(
            transmissions=_sent_by_cycle(hour),
            aircraft=(hour.flight != FREE).sum(axis=1),
            waiting=hour.waiting,
            fail_safe=hour.fail_safe,
            decision_ms=hour.decision_ms,
        ),
        flights=_flight_rows(sector, hour),
        losses=losses,
        close_pairs=_pair_events(hour, approaches, CLOSE_NM, moved),
        lax_s=_seconds(first, lax, hour),
        lax_without_births_s=_seconds(first, _ended(first, (LOSS, EXCURSION)), hour),
        strict_s=_seconds(first, strict, hour),
        lax_ended_by=lax,
        strict_ended_by=strict,
    )


def _inside_cycle(events: Iterable[PairEvent]) -> int | None:
    """The first cycle in which a pair was too close inside the sector."""
    return min(
        (each.inside_cycle for each in events if each.inside_cycle is not None), default=None
    )


def _cycle(happened: Bool[np.ndarray, " cycles"]) -> int | None:
    return next(iter(np.flatnonzero(happened).tolist()), None)


def _ended(first: Mapping[str, int | None], causes: Iterable[str]) -> str | None:
    """The cause of the earliest event, the first one listed if equal; None without events."""
    found = [(cycle, cause) for cause in causes if (cycle := first[cause]) is not None]
    return min(found, key=lambda each: each[0])[1] if found else None


def _seconds(first: Mapping[str, int | None], cause: str | None, hour: Hour) -> float:
    """The time of the first event of a cause, or the length of the hour [s]."""
    cycle = None if cause is None else first[cause]
    return float(CYCLE_S * (len(hour.flight) if cycle is None else cycle + 1))


class _Approaches(NamedTuple):
    """The cycles in which two flights are close, in order of the cycles."""

    cycle: Int[np.ndarray, " n"]
    slots: Int[np.ndarray, "n 2"]
    squared_nm2: Float[np.ndarray, " n"]
    """The square of the minimum distance in the cycle without vertical separation."""


def _approaches(sector: Sector, hour: Hour, below_nm: float) -> _Approaches:
    """All cycles in which two flights are closer than a distance."""
    pairs = np.stack(np.triu_indices(hour.flight.shape[1], k=1), axis=1)
    squared_nm2 = compiled_squared_nm2(sector.plane, sector.separation_fl)
    present = hour.flight != FREE
    parts = []
    for begin in range(0, len(hour.flight), _CYCLES):
        rows = slice(begin, begin + _CYCLES)
        moved = (
            hour.before_nm,
            hour.traffic.position_nm,
            hour.before_level_ticks,
            hour.traffic.level_ticks,
        )
        columns = (np.moveaxis(np.asarray(each)[rows], 0, -1) for each in moved)
        squared = np.asarray(squared_nm2(*columns)).T
        both = present[rows][:, pairs].all(axis=2)
        cycle, pair = np.nonzero((squared < below_nm**2) & both)
        parts.append(_Approaches(begin + cycle, pairs[pair], squared[cycle, pair]))
    return _Approaches(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _pair_events(
    hour: Hour, approaches: _Approaches, below_nm: float, moved: Mapping[int, int]
) -> list[PairEvent]:
    """The first time that each pair of flights is closer than a distance, in order of time.

    `moved` has the first cycle in which each flight moves.
    """
    found: dict[tuple[int, int], PairEvent] = {}
    close = approaches.squared_nm2 < below_nm**2
    for cycle, slots in zip(approaches.cycle[close], approaches.slots[close], strict=True):
        at = int(cycle)
        older, younger = sorted(hour.flight[at, slots].tolist())
        inside = at if hour.entered[at, slots].all() else None
        known = found.get((older, younger))
        if known is None:
            at_birth = at <= moved.get(younger, len(hour.flight))
            found[older, younger] = PairEvent(at, older, younger, at_birth, inside)
        elif known.inside_cycle is None:
            found[older, younger] = known._replace(inside_cycle=inside)
    return list(found.values())


def _first_moves(hour: Hour) -> dict[int, int]:
    """The first cycle in which each flight moves, if it does."""
    moves = np.any(hour.before_nm != hour.traffic.position_nm, axis=-1) & (hour.flight != FREE)
    flight, first = np.unique(hour.flight[moves], return_index=True)
    cycle = np.nonzero(moves)[0]  # in ascending order
    return dict(zip(flight.tolist(), cycle[first].tolist(), strict=True))


def _flight_rows(sector: Sector, hour: Hour) -> list[FlightRow]:
    sent = np.bincount(
        [each.flight for each in hour.sent], minlength=int(hour.flight.max(initial=0)) + 1
    )
    rows = []
    for slot, column in enumerate(hour.flight.T):
        for flight in np.unique(column[column != FREE]).tolist():
            cycles = np.flatnonzero(column == flight)
            rows.append(_flight_row(sector, hour, slot, cycles, int(sent[flight])))
    return sorted(rows)


def _flight_row(
    sector: Sector, hour: Hour, slot: int, cycles: Int[np.ndarray, " rows"], transmissions: int
) -> FlightRow:
    last, traffic = int(cycles[-1]), hour.traffic
    before, after = hour.before_nm[cycles, slot], np.asarray(traffic.position_nm)[cycles, slot]
    scale = sector.plane.scale((before[:, 1] + after[:, 1]) / 2.0)
    flown_nm = float(np.sum(np.hypot(*(after - before).T) / scale))
    exited, excursion = bool(hour.exited[last, slot]), bool(hour.excursion[last, slot])
    route = int(traffic.route[last, slot])
    offset_nm = extra_nm = delay_s = np.nan
    if exited:
        crossing = crossing_nm(sector, np.array([route]), before[-1:], after[-1:])
        offset_nm = float(distance_to_exit_nm(sector, np.array([route]), crossing)[0])
        extra_nm = flown_nm - _route_nm(sector, route, before[0])
        delay_s = 3600.0 * extra_nm / float(traffic.ground_speed_kt[last, slot])
    level = traffic.level_ticks[cycles, slot]
    moving = hour.before_level_ticks[cycles, slot] != level
    stops = np.flatnonzero(moving[:-1] & ~moving[1:])
    goal = hour.exit_level_ticks[last, slot]
    return FlightRow(
        flight=int(hour.flight[last, slot]),
        birth=int(cycles[0]),
        gone=last if exited or excursion else None,
        exited=exited,
        correct=bool(hour.exited_correctly[last, slot]),
        excursion=excursion,
        exit_offset_nm=offset_nm,
        flown_nm=flown_nm,
        extra_nm=extra_nm,
        delay_s=delay_s,
        level_offs=int(np.sum(level[stops] != goal)),
        transmissions=transmissions,
    )


def _route_nm(sector: Sector, route: int, birth_nm: Float[np.ndarray, "2"]) -> float:
    """The length of a route from abeam a position of birth to its exit [NM]."""
    table = sector.route_table
    first = table.fixes_nm[route, 0].astype(np.float64)
    along = float(np.dot(birth_nm - first, table.leg_direction[route, 0]))
    legs = float(table.leg_nm[route, : table.exit_fix[route]].sum())
    legs -= LANDING_NM * float(table.lands[route])
    return legs - along / float(sector.plane.scale(first[1:])[0])


def summary(scores: Sequence[Scores], agent: str, traffic: str) -> dict[str, Any]:
    """The row of an evaluation; None where there is nothing to average.

    Exit and excursion rates are over the flights that left, transmissions over those born.
    """
    flights = [row for each in scores for row in each.flights]
    gone = [row for row in flights if row.gone is not None]
    exited = [row for row in gone if row.exited]
    losses = [event for each in scores for event in each.losses]
    cycles = CycleSeries(*map(np.concatenate, zip(*(each.cycles for each in scores), strict=True)))
    minutes = len(cycles.transmissions) / MINUTE_CYCLES
    transmissions = int(cycles.transmissions.sum())
    hours = minutes / 60.0

    def rate(count: float, total: float) -> float | None:
        return count / total if total else None

    def mean(values: Iterable[float]) -> float | None:
        array = np.array(list(values), dtype=float)
        return float(array.mean()) if array.size else None

    route_nm = sum(row.flown_nm - row.extra_nm for row in exited)
    return {
        "agent": agent,
        "traffic": traffic,
        "hours": round(hours, 6),
        "flights": len(flights),
        "flights_gone": len(gone),
        "flights_waiting_max": int(cycles.waiting.max()),
        "aircraft_max": int(cycles.aircraft.max()),
        "losses_of_separation": len(losses),
        "losses_at_birth": sum(event.at_birth for event in losses),
        "close_pairs": sum(len(each.close_pairs) for each in scores),
        "fail_safe_rate": float(np.mean(cycles.fail_safe)),
        "losses_per_flight_hour": rate(
            len(losses), float(cycles.aircraft.sum()) * CYCLE_S / 3600.0
        ),
        "deliveries": sum(row.correct for row in gone),
        "correct_exit_rate": rate(sum(row.correct for row in gone), len(gone)),
        "exit_rate": rate(len(exited), len(gone)),
        "excursion_rate": rate(sum(row.excursion for row in gone), len(gone)),
        "exit_offset_nm_median": _median(
            [row.exit_offset_nm for row in exited if np.isfinite(row.exit_offset_nm)]
        ),
        "transmissions_per_flight": rate(transmissions, len(flights)),
        "transmissions_per_minute": rate(transmissions, minutes),
        "transmissions_worst_minute": max(
            _worst_minute(each.cycles.transmissions) for each in scores
        ),
        "extra_miles_rate": rate(sum(row.extra_nm for row in exited), route_nm),
        "level_offs_per_flight": mean(row.level_offs for row in gone),
        "delay_s_mean": mean(row.delay_s for row in exited),
        "lax_s_mean": mean(each.lax_s for each in scores),
        "lax_s_by_hour": [each.lax_s for each in scores],
        "lax_without_births_s_mean": mean(each.lax_without_births_s for each in scores),
        "strict_s_mean": mean(each.strict_s for each in scores),
        "strict_s_by_hour": [each.strict_s for each in scores],
        "lax_ended_by": _causes(each.lax_ended_by for each in scores),
        "strict_ended_by": _causes(each.strict_ended_by for each in scores),
        "decision_ms_median": float(np.median(cycles.decision_ms)),
        "decision_ms_p99": float(np.percentile(cycles.decision_ms, 99.0)),
    }


def _causes(ended_by: Iterable[str | None]) -> dict[str, int]:
    """The number of hours ended by each cause."""
    counts = Counter(ended_by)
    return {cause: counts[cause] for cause in CAUSES if counts[cause]}


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _sent_by_cycle(hour: Hour) -> Int[np.ndarray, " cycles"]:
    cycles = np.array([each.cycle for each in hour.sent], dtype=np.int64)
    return np.bincount(cycles, minlength=len(hour.flight))


def _worst_minute(sent: Int[np.ndarray, " cycles"]) -> int:
    """The maximum number of transmissions within a minute."""
    window = np.ones(min(MINUTE_CYCLES, len(sent)), dtype=np.int64)
    return int(np.convolve(sent, window, mode="valid").max())
