"""A task for plain Python: one scenario, numpy observations, and one compiled program per call.

For policies of any library, for `skystack.stacking.stack`, and for adapters to other environment
interfaces.
After each instruction a caller needs the new state, its observation and the actions that may be
stacked. One program computes all three.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, PRNGKeyArray

from skystack.compilation.forks import refuse_forked
from skystack.compilation.packing import Packed, packed
from skystack.errors import InputError, checked_integer
from skystack.tasks.contract import Observation, Outcome, Task, TaskState
from skystack.tasks.programs import TaskPrograms, compiled


class View(NamedTuple):
    """The observation of a state and its allowed actions."""

    observation: Observation
    allowed: Bool[Array, " actions"]
    """`may_stack` of every action."""


@partial(jax.tree_util.register_dataclass, data_fields=["packed", "packed_view"], meta_fields=[])
@dataclass(frozen=True)
class PlainState:
    """The state of a scenario and its view."""

    packed: Packed
    """The task's state."""
    packed_view: Packed
    """Its `View`."""

    @cached_property
    def view(self) -> View:
        """The view as numpy arrays, which must not be changed."""
        view: View = self.packed_view.fetched()
        return view


def checked_action(action: Any, actions: int) -> int:
    """The action as an int. Raises InputError if it is not in the action table."""
    return checked_integer("action", action, 0, actions - 1)


def checked_actions(actions: Any, count: int, table: int) -> Int[np.ndarray, " count"]:
    """Actions for `count` scenarios or agents, from a table of so many actions.

    Raises InputError unless they are whole numbers from the table.
    """
    numbers = np.asarray(actions)
    whole = numbers.shape == (count,) and np.issubdtype(numbers.dtype, np.integer)
    if not whole or np.any((numbers < 0) | (numbers >= table)):
        raise InputError(
            f"actions are {actions!r} (allowed: {count} whole numbers from 0 to {table - 1})"
        )
    return numbers.astype(np.int32)


def _fetched(state: PlainState, outcome: Packed) -> tuple[PlainState, Outcome]:
    return state, outcome.fetched()


class PlainTask(TaskPrograms):
    """Implements `skystack.stacking.TwoPhase`, and `reset`, `advance` and `step` of a task.

    Can be copied and pickled; copies share the compiled programs. Raises InputError for an action
    that is not in the task's table, and in a process that was forked after JAX was started.

    Example:

        >>> import jax
        >>> import skystack
        >>> task = skystack.build_task(skystack.load_experiment("lateral").task)
        >>> sky = skystack.PlainTask(task)
        >>> state = sky.reset(jax.random.key(0))
        >>> sky.observe(state).shape
        (8,)
        >>> state, issued = skystack.stack(sky, skystack.find_policy("lateral"), state)
        >>> state, outcome = sky.advance(state)  # one radar cycle
        >>> bool(outcome.ended)
        False
    """

    def __init__(self, task: Task) -> None:
        super().__init__(task)
        self._actions = len(task.action_names)

    def reset(self, key: PRNGKeyArray) -> PlainState:
        """The random scenario of a key, at cycle 0."""
        return self._reset(key)

    def begin(self, state: TaskState) -> PlainState:
        """A scenario in the given state of the task."""
        return self._begin(state)

    def state_of(self, state: PlainState) -> TaskState:
        """The task's state of a scenario."""
        return self.unpacked(state.packed)

    def observe(self, state: PlainState) -> Any:
        """The observation: a numpy array, or a pytree of numpy arrays."""
        refuse_forked()  # the conversion may wait for one of JAX's threads
        return jax.tree.map(np.array, state.view.observation)

    def checked_action(self, action: Any) -> int:
        """The action as an int. Raises InputError if it is not in the action table."""
        return checked_action(action, self._actions)

    def may_stack(self, state: PlainState, action: Any) -> bool:
        refuse_forked()
        return bool(state.view.allowed[self.checked_action(action)])

    def instruct(self, state: PlainState, action: Any) -> PlainState:
        return self._instruct(state.packed, np.int32(self.checked_action(action)))

    def advance(self, state: PlainState) -> tuple[PlainState, Outcome]:
        """Fly one radar cycle. The outcome has numpy arrays."""
        return _fetched(*self._advance(state.packed))

    def step(self, state: PlainState, action: Any) -> tuple[PlainState, Outcome]:
        """The MDP step of the task. The outcome has numpy arrays."""
        return _fetched(*self._step(state.packed, np.int32(self.checked_action(action))))

    @compiled
    def _reset(self, key: PRNGKeyArray) -> PlainState:
        return self._plain_state(self._task.reset(key))

    @compiled
    def _begin(self, state: TaskState) -> PlainState:
        return self._plain_state(state)

    @compiled
    def _instruct(self, state: Packed, action: Int[Array, ""]) -> PlainState:
        return self._plain_state(self._task.instruct(state.unpacked(), action))

    @compiled
    def _advance(self, state: Packed) -> tuple[PlainState, Packed]:
        return self._after(*self._task.advance(state.unpacked()))

    @compiled
    def _step(self, state: Packed, action: Int[Array, ""]) -> tuple[PlainState, Packed]:
        return self._after(*self._task.step(state.unpacked(), action))

    def _after(self, state: TaskState, outcome: Outcome) -> tuple[PlainState, Packed]:
        return self._plain_state(state), packed(outcome)

    def _plain_state(self, state: TaskState) -> PlainState:
        return PlainState(packed(state), packed(self._view(state)))

    def _view(self, state: TaskState) -> View:
        actions = jnp.arange(len(self._task.action_names), dtype=jnp.int32)
        allowed: Any = jax.vmap(self._task.may_stack, (None, 0))(state, actions)
        return View(self._task.observe(state), allowed)
