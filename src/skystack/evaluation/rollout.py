"""Fly many scenarios with a policy in one compiled program, and record them."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, PRNGKeyArray

from skystack.compilation.shared import shared_program
from skystack.errors import InputError
from skystack.io.signals import check
from skystack.learning.choices import most_probable, sampled
from skystack.learning.inference import Layers, Normaliser
from skystack.learning.seeds import scenario_keys
from skystack.simulator.traffic import Traffic
from skystack.stacking import ENDLESS, NO_OP, Stack, stack_many_traced
from skystack.tasks.batch import choose, reset_each
from skystack.tasks.contract import AircraftStatus, Outcome, TaskState, TrafficTask

SCENARIOS_AT_ONCE = 1000
LEAST_AT_ONCE = 16
"""Fewer scenarios are filled up to this number."""
ROWS_AT_ONCE = 600_000
"""The rows (one per aircraft and cycle) flown at once, which take about 200 MB."""
_POLICY = 0x90_11C7
"""Folded into a scenario's key to obtain the keys for sampling actions."""


TracedPolicy = Callable[[Any, Float[Array, " observation"], PRNGKeyArray], Int[Array, ""]]
"""A traceable function (weights, observation, key) -> action."""


class Controller(NamedTuple):
    """A decision function and its weights."""

    decide: TracedPolicy
    weights: Any = ()


def network_controller(actor: Layers, normaliser: Normaliser, greedy: bool) -> Controller:
    """The controller of a policy's network: the most probable action, or a sampled one."""
    return Controller(most_probable if greedy else sampled, (actor, normaliser))


def _no_op(weights: Any, observation: Array, key: PRNGKeyArray) -> Int[Array, ""]:
    return jnp.full((), NO_OP, dtype=jnp.int32)


NO_OP_CONTROLLER = Controller(_no_op)
"""Never instructs an aircraft."""


class Recording(NamedTuple):
    """Flown scenarios as numpy arrays `[scenarios, cycles, ...]`. Index k is cycle k + 1."""

    number: Int[np.ndarray, " scenarios"]
    """The numbers of the scenarios under the evaluation seed."""
    start: Traffic
    """The traffic at cycle 0, `[scenarios, aircraft]`."""
    exit_level_ticks: Float[np.ndarray, "scenarios aircraft"]
    """The levels at which the aircraft must exit, in ticks."""
    start_status: AircraftStatus
    """The status at cycle 0, `[scenarios, aircraft]`."""
    traffic: Traffic
    """The traffic after each cycle."""
    status: AircraftStatus
    """The status after each cycle, `[scenarios, cycles, aircraft]`."""
    action: Int[np.ndarray, "scenarios cycles"]
    """The action stacked before the cycle was flown."""
    instructions: Int[np.ndarray, "scenarios cycles"]
    """The number of instructions in the stack; 0 if nothing was issued."""
    ran: Bool[np.ndarray, "scenarios cycles"]
    """Whether the scenario was still running in the cycle."""
    reward: Float[np.ndarray, "scenarios cycles"]
    """The task's reward, unscaled; 0 after the end."""
    metrics: dict[str, np.ndarray]
    """The metrics at the end, each `[scenarios]`."""

    def before(self, name: str) -> np.ndarray:
        """A field of the traffic before each cycle, when its clearance was issued."""
        start, later = getattr(self.start, name), getattr(self.traffic, name)
        return np.concatenate([np.asarray(start)[:, None], np.asarray(later)[:, :-1]], axis=1)


Fly = Callable[[Any, int, int], Iterator[Recording]]
"""Flies the first scenarios of an evaluation seed, block by block: (weights, seed, scenarios)."""


def fly(
    task: TrafficTask,
    controller: Controller,
    seed: int,
    scenarios: int,
    stacking: bool,
) -> Recording:
    """Fly scenarios 0, 1, ... of an evaluation seed, stacked or with one instruction per cycle.

    Raises InputError for a controller that returns an action that is not in the task's table.
    """
    fly_blocks = prepare(task, controller.decide, stacking)
    return concatenate(list(fly_blocks(controller.weights, seed, scenarios)))


def prepare(task: TrafficTask, decide: TracedPolicy, stacking: bool) -> Fly:
    """A function that flies blocks of scenarios with any weights.

    The program is compiled on first use, once for stacked and unstacked flights.
    """
    fly_block = shared_program(_fly_many, task, decide)
    limit = np.int32(ENDLESS if stacking else 1)
    most = _scenarios_in_block(task)

    def fly(weights: Any, seed: int, scenarios: int) -> Iterator[Recording]:
        for numbers in blocks(task, scenarios):
            filled = _filled_up(numbers, most)
            # No variable may keep a block alive while the next one is flown.
            flown = jax.device_get(fly_block(limit, weights, scenario_keys(seed, filled), filled))
            yield _checked(next(parts_of(flown, len(numbers))), len(task.action_names))
            del flown

    return fly


def _filled_up(numbers: Int[np.ndarray, " block"], most: int) -> Int[np.ndarray, " filled"]:
    """The scenarios of a block and the ones after them, so that few sizes are compiled.

    Sizes are powers of two from `LEAST_AT_ONCE`, or `most` if that is smaller.
    """
    size = max(LEAST_AT_ONCE, 1 << (len(numbers) - 1).bit_length())
    return np.arange(numbers[0], numbers[0] + min(size, most), dtype=np.int32)


def blocks(task: TrafficTask, scenarios: int) -> Iterator[Int[np.ndarray, " block"]]:
    """The scenario numbers 0, 1, ... in the blocks that are flown at once."""
    most = _scenarios_in_block(task)
    for first in range(0, scenarios, most):
        yield np.arange(first, min(first + most, scenarios), dtype=np.int32)


def _scenarios_in_block(task: TrafficTask) -> int:
    """The maximum number of scenarios flown at once."""
    return _scenarios_of(task, ROWS_AT_ONCE, SCENARIOS_AT_ONCE)


def scenarios_in_part(task: TrafficTask) -> int:
    """The number of scenarios tabulated at once: tables take more memory than arrays."""
    return _scenarios_of(task, ROWS_AT_ONCE // 4, SCENARIOS_AT_ONCE // 4)


def _scenarios_of(task: TrafficTask, rows: int, most: int) -> int:
    """The number of scenarios that fit into `rows` rows; at least 1 and at most `most`."""
    return min(max(rows // (task.cycles * task.aircraft), 1), most)


def _checked(recording: Recording, actions: int) -> Recording:
    """Check the actions: a compiled program silently clips those beyond the action table."""
    check()  # JAX may have discarded an interruption in a callback
    action = recording.action
    invalid = np.argwhere(recording.ran & ((action < 0) | (action >= actions)))
    if invalid.size:
        index, cycle = invalid[0]
        raise InputError(
            f"scenario {recording.number[index]}, cycle {cycle}: action is {action[index, cycle]} "
            f"(allowed: whole numbers from 0 to {actions - 1})"
        )
    return recording


def concatenate(parts: Sequence[Recording]) -> Recording:
    """Concatenate recordings along the scenario axis."""
    recording: Recording = jax.tree.map(lambda *arrays: np.concatenate(arrays), *parts)
    return recording


def parts_of(recording: Recording, scenarios: int) -> Iterator[Recording]:
    """Split a recording into parts of at most `scenarios` scenarios, without copying."""
    for first in range(0, len(recording.number), scenarios):
        rows = slice(first, first + scenarios)
        part: Recording = jax.tree.map(lambda values, rows=rows: values[rows], recording)
        yield part


def recording_of(
    number: Int[np.ndarray, " scenarios"],
    start: tuple[Any, ...],
    rows: Sequence[tuple[Any, ...]],
    cycles: int,
) -> Recording:
    """A recording of full length from `initial_fields` and the rows of `keep`, one per cycle.

    All arrays are `[scenarios, ...]`.

    If cycles are missing at the end, the last row is repeated, without instructions or reward.
    """
    missing = cycles - len(rows)
    columns = jax.tree.map(
        lambda *values: np.stack([*values, *values[-1:] * missing], axis=1), *rows
    )
    recording = Recording(number, *start, *columns)
    ran = recording.ran & (np.arange(cycles) < len(rows))
    last = ran.sum(axis=1) - 1
    return recording._replace(
        instructions=np.where(ran, recording.instructions, 0),
        ran=ran,
        reward=np.where(ran, recording.reward, 0.0).astype(np.float32),
        metrics=jax.tree.map(
            lambda values: values[np.arange(len(number)), last], recording.metrics
        ),
    )


def query_keys(task: TrafficTask, key: PRNGKeyArray) -> Key[Array, " cycles"]:
    """A scenario's keys for sampling actions, one per cycle."""
    return jax.random.split(jax.random.fold_in(key, _POLICY), task.cycles)


def initial_fields(task: TrafficTask, state: TaskState) -> tuple[Any, ...]:
    """The fields of a `Recording` at cycle 0, in order."""
    return task.traffic(state), task.exit_level_ticks(state), task.status(state)


def keep(
    task: TrafficTask,
    stack: Stack,
    state: TaskState,
    outcome: Outcome,
    over: Bool[Array, "*batch"],
) -> tuple[Any, ...]:
    """The fields of one cycle of a `Recording`, in order.

    `over`: the scenario ended in an earlier cycle.
    """
    return (
        task.traffic(state),
        task.status(state),
        stack.action,
        jnp.where(over, 0, stack.instructions),
        ~over,
        jnp.where(over, 0.0, jnp.sum(outcome.reward, axis=0)),
        outcome.metrics,
    )


def begin(
    task: TrafficTask, keys: Key[Array, " scenarios"]
) -> tuple[TaskState, Key[Array, "cycles scenarios"]]:
    """The states of scenarios at cycle 0, batch axis last, and the keys of their queries."""
    state: TaskState = reset_each(task, keys)
    return state, jax.vmap(partial(query_keys, task), out_axes=1)(keys)


def fly_cycle(
    task: TrafficTask, instructed: TaskState, stack: Stack, over: Bool[Array, " scenarios"]
) -> tuple[TaskState, Bool[Array, " scenarios"], tuple[Any, ...]]:
    """Fly a cycle of the scenarios that are not over; the others do not change.

    Returns the states, which scenarios are over now, and the cycle's fields of a `Recording`, all
    with the batch axis last.
    """
    advanced, outcome = task.advance(instructed)
    state = choose(over, instructed, advanced)
    return state, over | outcome.ended, keep(task, stack, state, outcome, over)


def _fly_many(
    task: TrafficTask,
    decide: TracedPolicy,
    limit: Int[Array, ""],
    weights: Any,
    keys: Key[Array, " scenarios"],
    numbers: Int[Array, " scenarios"],
) -> Recording:
    """Fly scenarios for all cycles of the task; a scenario that has ended does not change."""
    scenarios = _ManyScenarios(task)
    one_policy = partial(decide, weights)

    def cycle(
        carry: tuple[TaskState, Bool[Array, " scenarios"]], keys: Key[Array, " scenarios"]
    ) -> tuple[tuple[TaskState, Bool[Array, " scenarios"]], tuple[Any, ...]]:
        def policy(observations: Any, _mask: Any, query: Int[Array, " scenarios"]) -> Array:
            query_keys = jax.vmap(jax.random.fold_in)(keys, query)
            actions: Array = jax.vmap(one_policy, (-1, 0))(observations, query_keys)
            return actions

        state, over = carry
        instructed, stack = stack_many_traced(scenarios, policy, state, ~over, limit)
        state, over, row = fly_cycle(task, instructed, stack, over)
        return (state, over), row

    start, cycle_keys = begin(task, keys)
    over = jnp.zeros(len(numbers), dtype=bool)
    _, rows = jax.lax.scan(cycle, (start, over), cycle_keys)
    fields: Any = (numbers, *scenarios_first((*initial_fields(task, start), *rows)))
    recording = Recording(*fields)
    last = jnp.sum(recording.ran, axis=1) - 1
    return recording._replace(
        metrics=jax.tree.map(
            lambda values: values[jnp.arange(len(numbers)), last], recording.metrics
        )
    )


class _ManyScenarios:
    """Many scenarios of a task. Implements `skystack.stacking.ManyTwoPhase`."""

    def __init__(self, task: TrafficTask) -> None:
        self.observe, self.instruct, self.may_stack = task.observe, task.instruct, task.may_stack
        self.choose = choose


def scenarios_first(fields: Any) -> Any:
    """A tree of arrays with the axis of scenarios moved from last to first."""
    return jax.tree.map(lambda values: jnp.moveaxis(values, -1, 0), fields)
