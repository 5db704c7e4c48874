"""A check that a task keeps the contract of `skystack.tasks.contract`; for users' tasks too."""

import jax
import jax.numpy as jnp
import numpy as np

from skystack.tasks.contract import NO_OP, Task, TaskState


def check_task(task: Task, seed: int = 0, steps: int = 50) -> None:
    """Run a task with random actions. Raises AssertionError naming the first broken promise.

    Promises: the sizes of observation and action table fit their names; observations are finite
    and within [0, 1]; the same key gives the same scenario; shapes and types of the state never
    change; `step` is `advance` after `instruct` or, where time can stand still, one of the two.
    """
    keys = jax.random.split(jax.random.key(seed), steps + 1)
    state = jax.jit(task.reset)(keys[0])
    _require(_equal(state, jax.jit(task.reset)(keys[0])), "reset is not a function of its key")
    _require(len(set(task.action_names)) == len(task.action_names), "action names repeat")
    step, observe = jax.jit(task.step), jax.jit(task.observe)
    for key in keys[1:]:
        seen = np.asarray(observe(state))
        _require(seen.shape == (len(task.observation_names),), "observation does not fit its names")
        _require(bool(np.all(np.isfinite(seen))), "observation is not finite")
        _require(bool(np.all((seen >= 0.0) & (seen <= 1.0))), "observation is not within [0, 1]")
        action = jax.random.randint(key, (), 0, len(task.action_names))
        after, outcome = step(state, action)
        _require(_alike(state, after), "step changes the shape or type of the state")
        _require(_alike(state, task.instruct(state, action)), "instruct changes shapes or types")
        _require(bool(jnp.isfinite(outcome.reward)), "reward is not finite")
        _require(not bool(outcome.terminated & outcome.truncated), "terminated and truncated")
        _require(
            not bool(task.may_stack(state, jnp.asarray(NO_OP, dtype=jnp.int32))),
            "no action can be stacked",
        )
        state = after


def _equal(a: TaskState, b: TaskState) -> bool:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(bool(jnp.array_equal(x, y)) for x, y in pairs)


def _alike(a: TaskState, b: TaskState) -> bool:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(x.shape == y.shape and x.dtype == y.dtype for x, y in pairs)


def _require(holds: bool, broken: str) -> None:
    if not holds:
        raise AssertionError(broken)
