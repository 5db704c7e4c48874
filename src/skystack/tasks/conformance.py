"""A check that a task, built-in or custom, satisfies the contract `skystack.tasks.contract`."""

import jax
import jax.numpy as jnp
import numpy as np

from skystack.stacking import NO_OP
from skystack.tasks.contract import ManyAgents, Outcome, Task, TaskState
from skystack.tasks.observations import flatten_observation


def check_task(task: Task, seed: int = 0, steps: int = 50) -> None:
    """Run a task with random actions. Raises AssertionError that states the first violation.

    Checks that the observation has a value for each name and action names are unique; observations
    are finite and in [0, 1]; the same key gives the same scenario; shapes and types of the state
    never change; action 0 cannot be stacked; rewards and ends have an axis of agents; if the
    scenario has ended, all agents have; and outcomes have the specified metrics.
    """
    agents = (task.agents,) if isinstance(task, ManyAgents) else ()
    keys = jax.random.split(jax.random.key(seed), steps + 1)
    # Compiled twice, because a compiled function repeats whatever it was traced with.
    state = jax.jit(task.reset)(keys[0])
    _require(_equal(state, jax.jit(task.reset)(keys[0])), "reset is not a function of its key")
    _require(len(set(task.action_names)) == len(task.action_names), "action names repeat")
    step, observe, instruct = jax.jit(task.step), jax.jit(task.observe), jax.jit(task.instruct)
    for key in keys[1:]:
        values = np.asarray(flatten_observation(observe(state), len(agents)))
        _require(
            values.shape == (len(task.observation_names), *agents),
            "observation does not fit its names",
        )
        _require(bool(np.all(np.isfinite(values))), "observation is not finite")
        _require(bool(np.all((values >= 0.0) & (values <= 1.0))), "observation is not in [0, 1]")
        action = jax.random.randint(key, agents, 0, len(task.action_names))
        next_state, outcome = step(state, action)
        _require(_same_types(state, next_state), "step changes the shape or type of the state")
        _require(_same_types(state, instruct(state, action)), "instruct changes shapes or types")
        _require(
            not bool(jnp.any(task.may_stack(state, jnp.full(agents, NO_OP, dtype=jnp.int32)))),
            "may_stack allows action 0, which is no instruction",
        )
        _check_outcome(task, outcome)
        state = next_state


def _check_outcome(task: Task, outcome: Outcome) -> None:
    for values in (outcome.reward, outcome.terminated, outcome.truncated):
        _require(values.shape == (task.agents,), "rewards or ends have no axis of agents")
    _require(bool(jnp.all(jnp.isfinite(outcome.reward))), "reward is not finite")
    both = outcome.terminated & outcome.truncated
    _require(not bool(jnp.any(both)), "an agent is terminated and truncated")
    all_ended = jnp.all(outcome.terminated | outcome.truncated)
    _require(bool(all_ended) or not bool(outcome.ended), "the scenario has ended, an agent has not")
    _require(set(outcome.metrics) == set(task.metrics), "metrics are not those specified")


def _equal(a: TaskState, b: TaskState) -> bool:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(bool(jnp.array_equal(x, y)) for x, y in pairs)


def _same_types(a: TaskState, b: TaskState) -> bool:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(x.shape == y.shape and x.dtype == y.dtype for x, y in pairs)


def _require(condition: bool, violation: str) -> None:
    if not condition:
        raise AssertionError(violation)
