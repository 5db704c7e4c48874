"""Fly many scenarios under a policy, inside one compiled program, and keep what happened."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, PRNGKeyArray

from skystack.errors import InputError
from skystack.io.signals import check
from skystack.learning.inference import Layers, Normaliser, forward, normalise
from skystack.learning.seeds import scenario_keys
from skystack.simulator.traffic import Traffic
from skystack.stacking import Stack, stack_traced
from skystack.tasks.batch import choose
from skystack.tasks.contract import NO_OP, Metrics, Outcome
from skystack.tasks.navigation import NavigationState, NavigationTask

SCENARIOS_AT_ONCE = 1000
ROWS_AT_ONCE = 600_000
"""Rows (one per aircraft and cycle) flown at once, which take about 200 MB."""
_POLICY = 0x90_11C7
"""Folded into a scenario's key for a policy that samples."""


TracedPolicy = Callable[[Any, Float[Array, " observation"], PRNGKeyArray], Int[Array, ""]]
"""A traceable function of (weights, observation, key)."""


class Controller(NamedTuple):
    """What decides, and its weights."""

    decide: TracedPolicy
    weights: Any = ()


def network_controller(actor: Layers, normaliser: Normaliser, greedy: bool) -> Controller:
    """A policy's network: the most probable action, or one drawn by its probability."""
    return Controller(most_probable if greedy else _sample, (actor, normaliser))


def most_probable(
    weights: tuple[Layers, Normaliser], observation: Array, key: PRNGKeyArray
) -> Int[Array, ""]:
    """The action that a network, (actor, normaliser), holds most probable."""
    return jnp.argmax(_logits(weights, observation)).astype(jnp.int32)


def _sample(
    weights: tuple[Layers, Normaliser], observation: Array, key: PRNGKeyArray
) -> Int[Array, ""]:
    return jax.random.categorical(key, _logits(weights, observation)).astype(jnp.int32)


def _logits(weights: tuple[Layers, Normaliser], observation: Array) -> Array:
    actor, normaliser = weights
    logits: Array = forward(actor, normalise(normaliser, observation))
    return logits


def _no_op(weights: Any, observation: Array, key: PRNGKeyArray) -> Int[Array, ""]:
    return jnp.full((), NO_OP, dtype=jnp.int32)


NO_OP_CONTROLLER = Controller(_no_op)
"""Instructs nobody, ever."""


class Recording(NamedTuple):
    """Scenarios flown: `[scenarios, cycles, ...]`, numpy. Row k of a scenario is its cycle k+1."""

    number: Int[np.ndarray, " scenarios"]
    """Of the scenario, under the evaluation seed."""
    start: Traffic
    """Cycle 0, `[scenarios, aircraft]`."""
    exit_level_ticks: Float[np.ndarray, "scenarios aircraft"]
    """At which they are to leave, in ticks."""
    traffic: Traffic
    """After each cycle."""
    entered: Bool[np.ndarray, "scenarios cycles aircraft"]
    exited: Bool[np.ndarray, "scenarios cycles aircraft"]
    excursion: Bool[np.ndarray, "scenarios cycles aircraft"]
    action: Int[np.ndarray, "scenarios cycles"]
    """The instruction that was stacked before the cycle was flown."""
    instructions: Int[np.ndarray, "scenarios cycles"]
    """How many of them: 0, and nothing was issued."""
    ran: Bool[np.ndarray, "scenarios cycles"]
    """Whether the scenario was still going on in the cycle."""
    reward: Float[np.ndarray, "scenarios cycles"]
    """Of the task, unscaled; 0 after the end."""
    metrics: Metrics
    """At the end, `[scenarios]`."""

    def before(self, name: str) -> np.ndarray:
        """A field of the traffic before each cycle, when its clearance was given."""
        start, later = getattr(self.start, name), getattr(self.traffic, name)
        return np.concatenate([np.asarray(start)[:, None], np.asarray(later)[:, :-1]], axis=1)


Fly = Callable[[Any, int, int], Iterator[Recording]]
"""Flies the first scenarios of an evaluation seed, block by block: (weights, seed, scenarios)."""


def fly(
    task: NavigationTask,
    controller: Controller,
    seed: int,
    scenarios: int,
    stacking: bool,
) -> Recording:
    """Fly scenarios 0, 1, ... of an evaluation seed, stacked or one instruction a cycle.

    Raises InputError for a controller that answers with what is not in the task's action table.
    """
    flown = prepare(task, controller.decide, stacking)
    return concatenate(list(flown(controller.weights, seed, scenarios)))


def prepare(task: NavigationTask, decide: TracedPolicy, stacking: bool) -> Fly:
    """Blocks of `fly` for controllers with the same `decide`: compiled once, when first used."""
    limit = None if stacking else 1
    flown = jax.jit(jax.vmap(partial(_fly_one, task, decide, limit), in_axes=(None, 0, 0)))

    def fly(weights: Any, seed: int, scenarios: int) -> Iterator[Recording]:
        for numbers in blocks(task, scenarios):
            # No variable keeps a block alive while the next one is flown.
            yield _checked(
                jax.device_get(flown(weights, scenario_keys(seed, numbers), numbers)),
                len(task.action_names),
            )

    return fly


def blocks(task: NavigationTask, scenarios: int) -> Iterator[Int[np.ndarray, " block"]]:
    """The numbers 0, 1, ... of scenarios, as many together as are flown at once."""
    most = _scenarios_of(task, ROWS_AT_ONCE, SCENARIOS_AT_ONCE)
    for first in range(0, scenarios, most):
        yield np.arange(first, min(first + most, scenarios), dtype=np.int32)


def scenarios_in_part(task: NavigationTask) -> int:
    """The number of scenarios whose tables are made at once: they need more memory than arrays."""
    return _scenarios_of(task, ROWS_AT_ONCE // 4, SCENARIOS_AT_ONCE // 4)


def _scenarios_of(task: NavigationTask, rows: int, most: int) -> int:
    """The number of scenarios that fit into `rows` rows; at least 1 and at most `most`."""
    return min(max(rows // (task.settings.cycles * task.scenarios.aircraft), 1), most)


def _checked(recording: Recording, actions: int) -> Recording:
    """Inside a compiled program an action beyond the table would be taken for the last one."""
    check()  # an interruption may have been lost in a callback
    asked = recording.action
    beyond = np.argwhere(recording.ran & ((asked < 0) | (asked >= actions)))
    if beyond.size:
        index, cycle = beyond[0]
        raise InputError(
            f"scenario {recording.number[index]}, cycle {cycle}: action is {asked[index, cycle]} "
            f"(allowed: whole numbers from 0 to {actions - 1})"
        )
    return recording


def concatenate(parts: Sequence[Recording]) -> Recording:
    """Recordings of some scenarios each as one of all."""
    whole: Recording = jax.tree.map(lambda *arrays: np.concatenate(arrays), *parts)
    return whole


def parts_of(recording: Recording, scenarios: int) -> Iterator[Recording]:
    """Split a recording into parts of at most `scenarios` scenarios, without copying."""
    for first in range(0, len(recording.number), scenarios):
        rows = slice(first, first + scenarios)
        part: Recording = jax.tree.map(lambda values, rows=rows: values[rows], recording)
        yield part


def recording_of(
    number: Int[np.ndarray, " scenarios"],
    start: Traffic,
    exit_level_ticks: Float[np.ndarray, "scenarios aircraft"],
    rows: Sequence[tuple[Any, ...]],
    cycles: int,
) -> Recording:
    """A recording of full length from what `keep` kept of each cycle, `[scenarios, ...]`.

    Where cycles are missing at the end the last one repeats, and nothing happens in it.
    """
    missing = cycles - len(rows)
    kept = jax.tree.map(lambda *values: np.stack([*values, *values[-1:] * missing], axis=1), *rows)
    recording = Recording(number, start, exit_level_ticks, *kept)
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


def query_keys(task: NavigationTask, key: PRNGKeyArray) -> Key[Array, " cycles"]:
    """A scenario's keys for a policy that samples, one a cycle."""
    return jax.random.split(jax.random.fold_in(key, _POLICY), task.settings.cycles)


def keep(
    stack: Stack, flown: NavigationState, outcome: Outcome, over: Bool[Array, "*batch"]
) -> tuple[Any, ...]:
    """What a recording keeps of a cycle, in its order; `over`: the scenario had ended before."""
    return (
        flown.traffic,
        flown.memory.entered,
        flown.memory.exited,
        flown.memory.excursion,
        stack.action,
        jnp.where(over, 0, stack.instructions),
        ~over,
        jnp.where(over, 0.0, outcome.reward),
        outcome.metrics,
    )


def _fly_one(
    task: NavigationTask,
    decide: TracedPolicy,
    limit: int | None,
    weights: Any,
    key: PRNGKeyArray,
    number: Int[Array, ""],
) -> Recording:
    """One scenario to its end; cycles after it repeat its last state."""
    start: NavigationState = task.reset(key)
    policy = partial(decide, weights)

    def cycle(
        carry: tuple[NavigationState, Bool[Array, ""]], key: PRNGKeyArray
    ) -> tuple[tuple[NavigationState, Bool[Array, ""]], tuple[Any, ...]]:
        state, over = carry
        told, stack = stack_traced(task, policy, state, key, limit)
        flown, outcome = task.advance(told)
        state = choose(over, state, flown)
        return (state, over | outcome.terminated), keep(stack, state, outcome, over)

    over = jnp.zeros((), dtype=bool)
    _, kept = jax.lax.scan(cycle, (start, over), query_keys(task, key))
    recording = Recording(number, start.traffic, start.memory.exit_level_ticks, *kept)  # type: ignore[arg-type]
    last = jnp.sum(recording.ran) - 1
    return recording._replace(metrics=jax.tree.map(lambda values: values[last], recording.metrics))
