"""Fly hours of arriving traffic under an agent of sector control, and record them."""

import time
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.agents.transmission import PER_CYCLE, SectorAgent, Transmission, clearance_of
from skystack.compilation.fetch import fetched
from skystack.compilation.shared import shared_program
from skystack.errors import InputError
from skystack.learning.seeds import scenario_key
from skystack.simulator.arrivals import FREE
from skystack.simulator.traffic import Traffic
from skystack.tasks.sector_rewards import FAIL_SAFE_S
from skystack.tasks.sector_world import World, WorldCycle, WorldState

Tree = TypeVar("Tree")


class Sent(NamedTuple):
    """A transmission, its flight, and the number of cycles flown before it was issued."""

    cycle: int
    flight: int
    transmission: Transmission


class Hour(NamedTuple):
    """A flown hour; arrays are `[cycles, slots]`, and row k is cycle k + 1."""

    number: int
    """The number of the hour under the evaluation seed."""
    flight: Int[np.ndarray, "cycles slots"]
    candidate: Int[np.ndarray, "cycles slots"]
    """The candidate that became each flight. Its flight is the same under every agent."""
    before_nm: Float[np.ndarray, "cycles slots 2"]
    before_level_ticks: Float[np.ndarray, "cycles slots"]
    traffic: Traffic
    """After each cycle, with the flights that leave; numpy arrays."""
    exit_level_ticks: Float[np.ndarray, "cycles slots"]
    entered: Bool[np.ndarray, "cycles slots"]
    exited: Bool[np.ndarray, "cycles slots"]
    exited_correctly: Bool[np.ndarray, "cycles slots"]
    excursion: Bool[np.ndarray, "cycles slots"]
    waiting: Int[np.ndarray, " cycles"]
    fail_safe: Bool[np.ndarray, " cycles"]
    """Whether no flight would lose separation within `FAIL_SAFE_S` without a further clearance."""
    sent: list[Sent]
    decision_ms: Float[np.ndarray, " cycles"]
    """The time that the agent took before each cycle."""


@runtime_checkable
class Hours(Protocol):
    """Flies the traffic of hours, one after another. All arrays are numpy arrays."""

    def reset(self, seed: int, number: int) -> WorldState:
        """Begin hour `number` of an evaluation seed."""

    def advance(
        self, state: WorldState, transmissions: list[Transmission]
    ) -> tuple[WorldState, WorldCycle]:
        """Transmit, and fly one cycle."""

    def close(self) -> None:
        """Release all resources."""


class OwnHours:
    """Implements `Hours` in our simulator. Its programs are compiled once, on first use."""

    def __init__(self, world: World) -> None:
        self._reset = shared_program(world.reset)
        self._advance = shared_program(world.advance)
        self._instruct = shared_program(world.instruct)

    def reset(self, seed: int, number: int) -> WorldState:
        state: WorldState = fetched(self._reset(scenario_key(seed, number)))
        return state

    def instruct(self, state: WorldState, transmissions: list[Transmission]) -> WorldState:
        """The state after transmissions; no time passes."""
        slots = len(state.arrivals.flight)
        told: WorldState = self._instruct(state, clearance_of(transmissions, slots))
        return told

    def advance(
        self, state: WorldState, transmissions: list[Transmission]
    ) -> tuple[WorldState, WorldCycle]:
        if transmissions:
            state = self.instruct(state, transmissions)
        flown: tuple[WorldState, WorldCycle] = fetched(self._advance(state))
        return flown

    def close(self) -> None:
        """Do nothing."""


class HourFlyer:
    """Flies hours of a world's traffic, in our simulator or in another one."""

    def __init__(
        self,
        world: World,
        cycles: int,
        per_cycle: int | None = PER_CYCLE,
        hours: Hours | None = None,
    ) -> None:
        """`per_cycle` is the maximum number of transmissions in a cycle; None without a limit."""
        self.world, self.cycles, self.per_cycle = world, cycles, per_cycle
        self.hours = OwnHours(world) if hours is None else hours

    @cached_property
    def _fail_safe(self) -> Any:
        return shared_program(is_fail_safe, self.world)

    def fly(
        self,
        agent: SectorAgent,
        seed: int,
        number: int,
        on_cycle: Callable[[int], None] = lambda cycle: None,
    ) -> Hour:
        """Fly one hour of an evaluation seed.

        Raises InputError if the agent transmits too often, or to a slot without a flight.
        """
        state = self.hours.reset(seed, number)
        agent.begin(state)
        recorder = HourRecorder(number)
        for index in range(self.cycles):
            began = time.perf_counter()
            transmissions = agent.transmit(state)
            decision_ms = 1000.0 * (time.perf_counter() - began)
            self._check(state, transmissions)
            recorder.record_transmissions(state, transmissions)
            state, cycle = self.hours.advance(state, transmissions)
            recorder.record_cycle(state, cycle, bool(self._fail_safe(state)), decision_ms)
            on_cycle(index + 1)
        return recorder.hour()

    def _check(self, state: WorldState, transmissions: list[Transmission]) -> None:
        if self.per_cycle is not None and len(transmissions) > self.per_cycle:
            raise InputError(
                f"{len(transmissions)} transmissions in a cycle (allowed: {self.per_cycle})"
            )
        for each in transmissions:
            if state.arrivals.flight[each.slot] == FREE:
                raise InputError(f"a transmission to slot {each.slot}, which is free")


def is_fail_safe(world: World, state: WorldState) -> Bool[Array, "*batch"]:
    """Whether no flight would lose separation within `FAIL_SAFE_S` without a further clearance."""
    return jnp.all(world.time_to_loss_as_cleared(state, margin_nm=0.0) >= FAIL_SAFE_S, axis=0)


def copied(values: Tree) -> Tree:
    """A copy of a pytree in numpy's own memory.

    An array fetched from JAX keeps a JAX buffer alive, which is larger than a small array.
    """
    copies: Tree = jax.tree.map(np.array, values)
    return copies


class HourRecorder:
    """Records an hour while it is flown."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.sent: list[Sent] = []
        self._cycles: list[WorldCycle] = []
        self._candidates: list[Int[np.ndarray, " slots"]] = []
        self._fail_safe: list[bool] = []
        self._decision_ms: list[float] = []

    def record_transmissions(self, state: WorldState, transmissions: list[Transmission]) -> None:
        """Record transmissions that are issued in a state."""
        flight, cycle = state.arrivals.flight, len(self._cycles)
        self.sent += [Sent(cycle, int(flight[each.slot]), each) for each in transmissions]

    def record_cycle(
        self, state: WorldState, cycle: WorldCycle, fail_safe: bool, decision_ms: float = 0.0
    ) -> None:
        """Record a cycle and the state after it."""
        self._cycles.append(copied(cycle))
        self._candidates.append(np.array(state.arrivals.candidate))
        self._fail_safe.append(fail_safe)
        self._decision_ms.append(decision_ms)

    def forget_after(self, cycles: int) -> None:
        """Keep only the first cycles, and the transmissions issued before each of them."""
        self.sent = [each for each in self.sent if each.cycle < cycles]
        for recorded in (self._cycles, self._candidates, self._fail_safe, self._decision_ms):
            del recorded[cycles:]

    def hour(self) -> Hour:
        """What has been flown so far; at least one cycle.

        Transmissions that were issued after the last cycle are not included.
        """
        stacked: Any = jax.tree.map(lambda *values: np.stack(values), *self._cycles)
        return Hour(
            number=self.number,
            flight=stacked.flight,
            candidate=np.stack(self._candidates),
            before_nm=stacked.before_nm,
            before_level_ticks=stacked.before_level_ticks,
            traffic=stacked.traffic,
            exit_level_ticks=stacked.exit_level_ticks,
            entered=stacked.entered,
            exited=stacked.exited,
            exited_correctly=stacked.exited_correctly,
            excursion=stacked.excursion,
            waiting=stacked.waiting,
            fail_safe=np.array(self._fail_safe),
            sent=[each for each in self.sent if each.cycle < len(self._cycles)],
            decision_ms=np.array(self._decision_ms),
        )
