"""A task for plain Python: one scenario, numpy observations, each call a small compiled program.

For policies of any library, `skystack.stacking.stack` and environments of other interfaces. Whoever
has told somebody something asks three things next (the new state, what is seen of it, what may be
said now), so one program answers them all.
"""

from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.compilation.forks import refuse_forked
from skystack.errors import checked_whole
from skystack.tasks.contract import Outcome, Task, TaskState
from skystack.tasks.programs import TaskPrograms, compiled


class View(NamedTuple):
    """What is asked of a state."""

    observation: Float[Array, " observation"]
    allowed: Bool[Array, " actions"]
    """`may_stack` of every action."""


class PlainState(NamedTuple):
    """A scenario and the view of it."""

    packed: Float[Array, " values"]
    """Its state as one vector: handing over three dozen small arrays takes longer than all else."""
    view: View


def checked_action(action: Any, actions: int) -> int:
    """An action as a plain number. Raises InputError for one that is not in the table."""
    return checked_whole("action", action, 0, actions - 1)


class PlainTask(TaskPrograms):
    """Implements `skystack.stacking.TwoPhase`, and `reset`, `advance` and `step` of a task.

    Can be copied and pickled; copies share its programs. Raises InputError for an action that is
    not in the task's table, and in a process that was forked after JAX was started.
    """

    def __init__(self, task: Task) -> None:
        super().__init__(task)
        self._actions = len(task.action_names)

    def reset(self, key: PRNGKeyArray) -> PlainState:
        """The scenario of a key."""
        return self._reset(key)

    def begin(self, state: TaskState) -> PlainState:
        """A scenario in any state of the task."""
        return self._begin(state)

    def state_of(self, seen: PlainState) -> TaskState:
        """The task's own state of a scenario."""
        return self._unpacked(seen.packed)

    def observe(self, seen: PlainState) -> Float[np.ndarray, " observation"]:
        refuse_forked()  # the array may still be waiting for one of JAX's threads
        return np.asarray(seen.view.observation)

    def checked_action(self, action: Any) -> int:
        """An action as a plain number."""
        return checked_action(action, self._actions)

    def may_stack(self, seen: PlainState, action: Any) -> bool:
        refuse_forked()
        return bool(np.asarray(seen.view.allowed)[self.checked_action(action)])

    def instruct(self, seen: PlainState, action: Any) -> PlainState:
        return self._instruct(seen.packed, np.int32(self.checked_action(action)))

    def advance(self, seen: PlainState) -> tuple[PlainState, Outcome]:
        """One radar cycle."""
        return self._advance(seen.packed)

    def step(self, seen: PlainState, action: Any) -> tuple[PlainState, Outcome]:
        """The MDP step of the task."""
        return self._step(seen.packed, np.int32(self.checked_action(action)))

    @compiled
    def _reset(self, key: PRNGKeyArray) -> PlainState:
        return self._seen(self._task.reset(key))

    @compiled
    def _begin(self, state: TaskState) -> PlainState:
        return self._seen(state)

    @compiled
    def _unpacked(self, packed: Float[Array, " values"]) -> TaskState:
        return self._unpack(packed)

    @compiled
    def _instruct(self, packed: Float[Array, " values"], action: Int[Array, ""]) -> PlainState:
        return self._seen(self._task.instruct(self._unpack(packed), action))

    @compiled
    def _advance(self, packed: Float[Array, " values"]) -> tuple[PlainState, Outcome]:
        state, outcome = self._task.advance(self._unpack(packed))
        return self._seen(state), outcome

    @compiled
    def _step(
        self, packed: Float[Array, " values"], action: Int[Array, ""]
    ) -> tuple[PlainState, Outcome]:
        state, outcome = self._task.step(self._unpack(packed), action)
        return self._seen(state), outcome

    @cached_property
    def _like(self) -> TaskState:
        return jax.eval_shape(lambda: self._task.reset(jax.random.key(0)))

    def _seen(self, state: TaskState) -> PlainState:
        leaves = [jnp.ravel(leaf).astype(jnp.float32) for leaf in jax.tree.leaves(state)]
        return PlainState(jnp.concatenate(leaves), self._view(state))

    def _unpack(self, packed: Float[Array, " values"]) -> TaskState:
        leaves, tree = jax.tree.flatten(self._like)
        parts = jnp.split(packed, np.cumsum([leaf.size for leaf in leaves])[:-1])
        shaped = [
            part.reshape(leaf.shape).astype(leaf.dtype)
            for part, leaf in zip(parts, leaves, strict=True)
        ]
        return jax.tree.unflatten(tree, shaped)

    def _view(self, state: TaskState) -> View:
        every = jnp.arange(len(self._task.action_names), dtype=jnp.int32)
        allowed: Any = jax.vmap(self._task.may_stack, (None, 0))(state, every)
        return View(self._task.observe(state), allowed)
