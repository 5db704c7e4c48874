"""A task for plain Python: one scenario, numpy observations, each call a small compiled program.

For policies of any library, `skystack.stacking.stack` and environments of other interfaces. Telling
somebody something needs three answers afterwards (the new state, what is seen of it, whether more
may be said), so one program gives all three.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from skystack.tasks.contract import NO_ACTION, Outcome, Task, TaskState


class Seen(NamedTuple):
    """A scenario's state and what goes with it."""

    state: TaskState
    observation: Any
    said: int
    """The instruction that `may_stack` is known for."""
    may_stack: Any


class PlainTask:
    """Implements `skystack.stacking.TwoPhase`, and `reset` and `advance` of a task."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._reset, self._see = jax.jit(task.reset), jax.jit(self._seen)
        self._told, self._flown = jax.jit(self._tell), jax.jit(self._fly)
        self._allowed = jax.jit(task.may_stack)

    def reset(self, key: PRNGKeyArray) -> Seen:
        """The scenario of a key."""
        return self.begin(self._reset(key))

    def begin(self, state: TaskState) -> Seen:
        """A scenario in any state of the task."""
        return Seen(state, self._see(state), NO_ACTION, False)

    def observe(self, seen: Seen) -> Float[np.ndarray, " observation"]:
        return np.asarray(seen.observation)

    def may_stack(self, seen: Seen, action: int | np.integer) -> bool:
        if int(action) == seen.said:
            return bool(seen.may_stack)
        return bool(self._allowed(seen.state, np.int32(action)))

    def instruct(self, seen: Seen, action: int | np.integer) -> Seen:
        state, observation, allowed = self._told(seen.state, np.int32(action))
        return Seen(state, observation, int(action), allowed)

    def advance(self, seen: Seen) -> tuple[Seen, Outcome]:
        """One radar cycle."""
        state, observation, outcome = self._flown(seen.state)
        return Seen(state, observation, NO_ACTION, False), outcome

    def _seen(self, state: TaskState) -> Float[Array, " observation"]:
        return self._task.observe(state)

    def _tell(self, state: TaskState, action: Int[Array, ""]) -> tuple[TaskState, Array, Array]:
        told = self._task.instruct(state, action)
        return told, self._task.observe(told), self._task.may_stack(told, action)

    def _fly(self, state: TaskState) -> tuple[TaskState, Array, Outcome]:
        flown, outcome = self._task.advance(state)
        return flown, self._task.observe(flown), outcome
