"""Arrivals, as in queueing: flights that enter the traffic while the simulation runs.

Candidates are drawn at reset. Before each cycle, the clock decides how many flights are due, and
for each of them, the first candidate that is clear of the traffic enters. It takes the lowest free
slot and keeps it until it leaves.

    admit(arrivals, traffic)  -> (arrivals, traffic)    before a cycle is flown
    fly(simulator, arrivals, traffic) -> (arrivals, traffic)    the cycle: newborns are held
    release(arrivals, traffic, gone) -> (arrivals, traffic)    after flights have left

A newborn is held at its position for at least the cycle before which it is admitted, so that it is
first reported exactly there.
"""

from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.geometry import length
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S, Simulator
from skystack.simulator.traffic import Traffic, start, where_aircraft

FREE = -1
"""The flight of a free slot."""
CLEAR_NM = 10.0
"""A newborn keeps this distance from a flight if its level is between that flight's present and
cleared level, rounded outwards to multiples of ten. With `unchecked_clearances`, only clearances
that have been adopted count."""
SAME_LEVEL_NM = 60.0
"""A newborn keeps this distance from traffic at exactly its own level."""
MOST_DUE = 16
"""The maximum number of births drawn for one cycle."""
_LEVEL_STEP = 10.0 * TICKS_PER_FL


class Candidates(NamedTuple):
    """Flights in the order in which they ask to enter; `[candidates, *batch]` each."""

    due_s: Float[Array, "candidates *batch"]
    """The time of birth in a recorded list; 0 if the clock decides."""
    route: Int[Array, "candidates *batch"]
    position_nm: Float[Array, "candidates 2 *batch"]
    heading_deg: Float[Array, "candidates *batch"]
    entry_level_ticks: Float[Array, "candidates *batch"]
    exit_level_ticks: Float[Array, "candidates *batch"]
    airspeed_factor: Float[Array, "candidates *batch"]
    climb_factor: Float[Array, "candidates *batch"]
    kind: Int[Array, "candidates *batch"] | None = None
    """Index of the type in the types of the performance model; None for the first type."""
    cleared_level_ticks: Float[Array, "candidates *batch"] | None = None
    """None if flights are cleared to their entry levels."""
    own_navigation: Bool[Array, "candidates *batch"] | None = None
    """None if no flight is on own navigation."""
    contact_s: Float[Array, "candidates *batch"] | None = None
    """The time from which flights hear clearances; None if from birth."""


class Arrivals(NamedTuple):
    """The flights in the slots, and the state of the clock."""

    flight: Int[Array, "slots *batch"]
    """The number of the flight in each slot, from 0 in order of birth; FREE if there is none."""
    candidate: Int[Array, "slots *batch"]
    """The index of the candidate that became each flight."""
    entry_level_ticks: Float[Array, "slots *batch"]
    exit_level_ticks: Float[Array, "slots *batch"]
    held: Int[Array, "slots *batch"]
    """The number of cycles for which a newborn is still held at its position."""
    candidates: Candidates
    uniforms: Float[Array, "cycles *batch"]
    """A number on [0, 1) for each cycle, which decides how many flights are due. Later cycles use
    the last one again."""
    used: Int[Array, "*batch"]
    """The number of candidates used so far."""
    born: Int[Array, "*batch"]
    """The number of flights born so far, which is the number of the next one."""
    waiting: Int[Array, "*batch"]
    """Flights that wait to enter: no slot is free, or no candidate is clear of the traffic."""
    refused: Int[Array, "*batch"]
    """Births that were given up."""
    rate_per_s: Float[Array, "*batch"]
    """The clock's rate at the start. It is part of the state, so it is not a constant in the
    compiled cycle."""
    last_birth_s: Float[Array, "*batch"]
    """The end of the cycle of the last birth, from which the quadratic clock counts."""
    cycle: Int[Array, "*batch"]
    """The number of cycles flown."""
    contact_s: Float[Array, "slots *batch"] | None = None
    """The time from which the flight in each slot hears clearances; None if from birth."""

    @property
    def time_s(self) -> Any:
        """The simulated time in seconds, `[*batch]`; in numpy if the arrivals are."""
        return (self.cycle * CYCLE_S).astype(np.float32)

    @property
    def in_contact(self) -> Any:
        """Whether the flight in each slot hears clearances: it is not held, and its time of
        contact has come.

        `[slots, *batch]`, in numpy if the arrivals are.
        """
        moves = self.held == 0
        if self.contact_s is None:
            return moves
        return moves & (self.contact_s <= self.time_s)


@dataclass(frozen=True)
class Clock:
    """Decides how many flights are due, and what happens to those that cannot be admitted.

    The rate starts at `rate_per_s` and increases by `increase_per_s` every `interval_s`, up to
    `max_rate_per_s`.
    """

    rate_per_s: float
    """Births per second at the start."""
    increase_per_s: float = 0.0
    interval_s: float = 60.0
    max_rate_per_s: float = 1.0
    until_s: float = float("inf")
    """No births after this time."""
    attempts: int = 11
    """The number of candidates that are tried for each birth."""
    quadratic: bool = False
    """Whether each cycle draws births for all seconds since the last birth, as BluebirdDT does.
    Otherwise, it draws them for the seconds since the last cycle."""
    unchecked_twins: bool = False
    """Whether flights born in the same cycle are not checked against each other, and births that
    find no clear candidate are given up, as in BluebirdDT. Otherwise such flights wait."""
    unchecked_clearances: bool = False
    """Whether clearances since the last cycle are not considered when a flight asks to enter, as in
    BluebirdDT, where they take effect after births. A flight may then be born next to one that has
    just been cleared through its level."""
    held_cycles: int = 1
    """The number of cycles for which a newborn is held; twins are held longer in BluebirdDT."""
    recorded: bool = False
    """Whether candidates are a recorded list: each is born at its time, without a check."""

    def due(self, arrivals: Arrivals) -> Int[Array, "*batch"]:
        """The number of flights due before the next cycle."""
        time_s = arrivals.time_s
        if self.recorded:
            due_s, used = arrivals.candidates.due_s, arrivals.used
            number = jnp.arange(due_s.shape[0], dtype=jnp.int32)
            number = number.reshape((-1,) + (1,) * used.ndim)
            due = (number >= used[None]) & (due_s <= time_s[None])
            return jnp.sum(due.astype(jnp.int32), axis=0)
        since_s = time_s - arrivals.last_birth_s if self.quadratic else float(CYCLE_S)
        steps = jnp.floor(time_s / self.interval_s)
        rate = arrivals.rate_per_s + steps * self.increase_per_s
        rate = jnp.minimum(rate, self.max_rate_per_s)
        cycles = arrivals.uniforms.shape[0]
        at = jnp.minimum(arrivals.cycle, cycles - 1)[None]
        uniform = jnp.take_along_axis(arrivals.uniforms, at, axis=0)[0]
        number = poisson(rate * since_s, uniform)
        running = (arrivals.cycle > 0) & (time_s <= self.until_s)
        if self.quadratic:
            running &= since_s >= CYCLE_S
        return jnp.where(running, number, 0) + arrivals.waiting


def poisson(mean: Float[Array, "*n"], uniform: Float[Array, "*n"]) -> Int[Array, "*n"]:
    """Poisson numbers by inverse transform sampling, at most `MOST_DUE`."""
    term = jnp.exp(-mean)
    cumulative, number = term, jnp.zeros_like(uniform, dtype=jnp.int32)
    for count in range(1, MOST_DUE + 1):
        number += (uniform >= cumulative).astype(jnp.int32)
        term = term * mean / count
        cumulative = cumulative + term
    return number


@dataclass(frozen=True)
class Admission:
    """Admits flights to traffic."""

    simulator: Simulator
    clock: Clock

    def admit(self, arrivals: Arrivals, traffic: Traffic) -> tuple[Arrivals, Traffic]:
        """Admit the flights that are due before the next cycle."""
        due, before = self.clock.due(arrivals), traffic
        arrivals = arrivals._replace(waiting=jnp.zeros_like(arrivals.waiting))

        def step(
            carry: tuple[Int[Array, ""], Arrivals, Traffic],
        ) -> tuple[Int[Array, ""], Arrivals, Traffic]:
            number, arrivals, traffic = carry
            checked = before if self.clock.unchecked_twins else traffic
            arrivals, traffic = self._admit_one(arrivals, traffic, checked, number < due, number)
            return number + 1, arrivals, traffic

        _, arrivals, traffic = jax.lax.while_loop(
            lambda carry: jnp.any(carry[0] < due), step, (jnp.int32(0), arrivals, traffic)
        )
        return arrivals, traffic

    def _admit_one(
        self,
        arrivals: Arrivals,
        traffic: Traffic,
        checked: Traffic,
        wanted: Bool[Array, "*batch"],
        twin: Int[Array, ""],
    ) -> tuple[Arrivals, Traffic]:
        """Admit one flight where it is wanted. `twin` counts those of the same cycle."""
        clock = self.clock
        attempts = 1 if clock.recorded else clock.attempts
        total = arrivals.candidates.route.shape[0]
        attempt = jnp.arange(attempts, dtype=jnp.int32).reshape((-1,) + (1,) * wanted.ndim)
        index = (arrivals.used[None] + attempt) % total
        tried = _take(arrivals.candidates, index)
        clear = jnp.ones_like(index, dtype=bool)
        if not clock.recorded:
            clear = self._clear(tried, checked)
        first = jnp.argmax(clear, axis=0).astype(jnp.int32)
        found = jnp.any(clear, axis=0)
        free = arrivals.flight == FREE
        slot = jnp.argmax(free, axis=0).astype(jnp.int32)
        has_slot = jnp.any(free, axis=0)
        born = wanted & found & has_slot
        # Without a free slot, no candidate is tried.
        used = jnp.where(wanted & has_slot, jnp.where(found, first + 1, attempts), 0)
        waits = wanted & ~born
        refused = waits & has_slot & clock.unchecked_twins
        chosen: Candidates = jax.tree.map(lambda values: _pick(values, first), tried)
        here = _one_hot(slot, free.shape[0]) & born[None]
        held = clock.held_cycles
        hold = held + _trailing_ones(twin) if clock.unchecked_twins else jnp.int32(held)
        number = _pick(index, first)
        time_s = arrivals.time_s
        arrivals = arrivals._replace(
            candidate=jnp.where(here, number[None], arrivals.candidate),
            held=jnp.where(here, hold, arrivals.held),
            used=arrivals.used + used,
            waiting=arrivals.waiting + (waits & ~refused).astype(jnp.int32),
            refused=arrivals.refused + refused.astype(jnp.int32),
            last_birth_s=jnp.where(born, time_s + CYCLE_S, arrivals.last_birth_s),
        )
        return enter(self.simulator, arrivals, traffic, here, chosen)

    def _clear(self, tried: Candidates, traffic: Traffic) -> Bool[Array, "attempts *batch"]:
        """Whether each candidate is clear of the traffic."""
        offset = tried.position_nm[:, None] - traffic.position_nm[None]
        shape = (-1, *offset.shape[2:])
        distance = length(offset.reshape(shape)).reshape(offset.shape[:2] + offset.shape[3:])
        distance = distance / self.simulator.sector.plane.scale(tried.position_nm[:, 1])[:, None]
        level = tried.entry_level_ticks[:, None]
        levels = [traffic.level_ticks, traffic.flown_level_ticks]
        if not self.clock.unchecked_clearances:
            levels.append(traffic.cleared_level_ticks)
        lower, upper = reduce(jnp.minimum, levels), reduce(jnp.maximum, levels)
        lower = jnp.floor(lower / _LEVEL_STEP) * _LEVEL_STEP
        upper = jnp.ceil(upper / _LEVEL_STEP) * _LEVEL_STEP
        overlaps = (lower[None] <= level) & (level <= upper[None])
        same = traffic.level_ticks[None] == level
        close = (overlaps & (distance < CLEAR_NM)) | (same & (distance < SAME_LEVEL_NM))
        return ~jnp.any(close & traffic.active[None], axis=1)


def enter(
    simulator: Simulator,
    arrivals: Arrivals,
    traffic: Traffic,
    here: Bool[Array, "slots *batch"],
    flight: Candidates,
) -> tuple[Arrivals, Traffic]:
    """Let a flight enter the traffic in the slot that the mask marks.

    `flight` has no axis for candidates. Where the mask marks no slot, nothing changes.
    """
    level = cleared = flight.entry_level_ticks[None]
    if flight.cleared_level_ticks is not None:
        cleared = flight.cleared_level_ticks[None]
    kind = None if flight.kind is None else flight.kind[None]
    own = flight.own_navigation
    newborn = start(
        position_nm=flight.position_nm[None],
        heading_deg=flight.heading_deg[None],
        level_ticks=level,
        route=flight.route[None],
        ground_speed_kt=simulator.level_ground_speed_kt(level, kind) * flight.airspeed_factor[None],
        own_navigation=jnp.zeros_like(level, dtype=bool) if own is None else own[None],
        kind=kind,
    )
    newborn = newborn._replace(
        flown_level_ticks=cleared,
        cleared_level_ticks=cleared,
        cleared_fix=newborn.next_fix,
        airspeed_factor=flight.airspeed_factor[None],
        climb_factor=flight.climb_factor[None],
    )
    arrivals = arrivals._replace(
        flight=jnp.where(here, arrivals.born[None], arrivals.flight),
        entry_level_ticks=jnp.where(here, level, arrivals.entry_level_ticks),
        exit_level_ticks=jnp.where(here, flight.exit_level_ticks[None], arrivals.exit_level_ticks),
        born=arrivals.born + jnp.any(here, axis=0).astype(jnp.int32),
    )
    if arrivals.contact_s is not None:
        assert flight.contact_s is not None, "candidates have no times of contact"
        contact_s = jnp.where(here, flight.contact_s[None], arrivals.contact_s)
        arrivals = arrivals._replace(contact_s=contact_s)
    return arrivals, where_aircraft(here, newborn, traffic)


def fly(simulator: Simulator, arrivals: Arrivals, traffic: Traffic) -> tuple[Arrivals, Traffic]:
    """Fly one cycle. Held newborns stay where they are."""
    moving = traffic.active & (arrivals.held == 0)
    flown = simulator.advance(traffic._replace(active=moving))._replace(active=traffic.active)
    return count_cycle(arrivals), flown


def count_cycle(arrivals: Arrivals) -> Arrivals:
    """The arrivals after a cycle has been flown."""
    return arrivals._replace(held=jnp.maximum(arrivals.held - 1, 0), cycle=arrivals.cycle + 1)


def release(
    arrivals: Arrivals, traffic: Traffic, gone: Bool[Array, "slots *batch"]
) -> tuple[Arrivals, Traffic]:
    """Free the slots of the flights that have left."""
    return (
        arrivals._replace(flight=jnp.where(gone, FREE, arrivals.flight)),
        traffic._replace(active=traffic.active & ~gone),
    )


def _take(candidates: Candidates, index: Int[Array, "attempts *batch"]) -> Candidates:
    def take(values: Array) -> Array:
        at = index if values.ndim == index.ndim else index[:, None]
        return jnp.take_along_axis(values, at, axis=0)

    taken: Candidates = jax.tree.map(take, candidates)
    return taken


def _pick(values: Array, index: Int[Array, "*batch"]) -> Array:
    """The entry of each scenario along the first axis."""
    at = index[None] if values.ndim == index.ndim + 1 else index[None, None]
    return jnp.take_along_axis(values, at, axis=0)[0]


def _one_hot(index: Int[Array, "*batch"], count: int) -> Bool[Array, "{count} *batch"]:
    number = jnp.arange(count, dtype=jnp.int32).reshape((-1,) + (1,) * index.ndim)
    return number == index[None]


def _trailing_ones(number: Int[Array, ""]) -> Int[Array, ""]:
    """The number of ones at the end of a number in binary."""
    lowest_zero = ~number & (number + 1)
    return jax.lax.population_count(lowest_zero - 1)
