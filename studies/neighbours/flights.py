"""Fly held-out scenarios decision by decision, and count clearances, successes and losses."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from skystack.evaluation.rollout import TracedPolicy
from skystack.learning.seeds import scenario_keys
from skystack.stacking import stack_traced
from skystack.tasks.batch import choose
from skystack.tasks.contract import Metrics, Task, TaskState
from studies.neighbours.methods import Build, Way

LOOK_AHEAD_CYCLES = 50
"""Five minutes."""


class Flown(NamedTuple):
    """The result of one scenario."""

    clearances: Float[Array, "*batch"]
    metrics: Metrics


class _Loop(NamedTuple):
    state: TaskState
    ended: Bool[Array, ""]
    number: Array
    """The decisions so far."""
    flown: Flown


def fly(
    tasks: Build, decide: TracedPolicy, weights: Any, way: Way, scenarios: int, seed: int = 0
) -> dict[str, float]:
    """Fly the first scenarios of an evaluation seed: one row of the table.

    A decision that instructs an aircraft counts as one clearance, and so does a stack. A success is
    a scenario in which every aircraft makes a correct exit and no excursion, regardless of the
    number of clearances.
    """
    keys = scenario_keys(seed, np.arange(scenarios, dtype=np.int32))
    program = jax.jit(jax.vmap(partial(_fly_one, tasks, decide, way), in_axes=(None, 0)))
    flown: Flown = jax.device_get(program(weights, keys))
    metrics = flown.metrics
    lost = metrics["min_separation_nm"] < tasks.loss_below_nm
    return {
        "clearances_mean": float(flown.clearances.mean()),
        "clearances_std": float(flown.clearances.std()),
        "success_rate": float(np.mean(metrics["correct_exit"] & ~metrics["excursion"])),
        "losses": float(lost.sum()),
    }


def _fly_one(
    tasks: Build, decide: TracedPolicy, way: Way, weights: Any, key: PRNGKeyArray
) -> Flown:
    task, policy = tasks.flown, partial(decide, weights)

    def body(loop: _Loop) -> _Loop:
        own_key = jax.random.fold_in(key, loop.number)
        if way.stacked:
            instructed, _ = stack_traced(task, policy, loop.state, own_key)
            if way.look_ahead:
                refused = worse(task, tasks.loss_below_nm, loop.state, instructed)
                instructed = choose(refused, loop.state, instructed)
            state, outcome = task.advance(instructed)
        else:
            action = policy(task.observe(loop.state), own_key)
            state, outcome = task.step(loop.state, action)
        before = loop.flown.metrics["instructions"]
        issued = (outcome.metrics["instructions"] > before).astype(jnp.float32)
        flown = Flown(loop.flown.clearances + issued, outcome.metrics)
        return _Loop(state, outcome.ended, loop.number + 1, flown)

    state = task.reset(key)
    like = jax.eval_shape(task.step, state, jnp.zeros((), dtype=jnp.int32))[1].metrics
    metrics = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like)
    zero = jnp.zeros((), dtype=jnp.int32)
    start = _Loop(state, jnp.zeros((), dtype=bool), zero, Flown(jnp.zeros(()), metrics))
    return jax.lax.while_loop(lambda loop: ~loop.ended, body, start).flown


def worse(
    task: Task, loss_below_nm: float, without: TaskState, instructed: TaskState
) -> Bool[Array, ""]:
    """Whether a clearance adds a loss of separation, or an excursion, within five minutes.

    Both futures are flown without further clearances. An excursion does not count as added if any
    aircraft makes one anyway. `task` is a navigation task.
    """

    def harms(state: TaskState) -> Bool[Array, "2"]:
        def cycle(state: TaskState, _: None) -> tuple[TaskState, Bool[Array, "2"]]:
            before = state.memory.progress.excursion
            state = task.advance(state)[0]
            lost = state.memory.separation.last_nm < loss_below_nm
            left = jnp.any(state.memory.progress.excursion & ~before)
            return state, jnp.stack([lost, left])

        return jax.lax.scan(cycle, state, length=LOOK_AHEAD_CYCLES)[1].any(axis=0)

    return jnp.any(harms(instructed) & ~harms(without))
