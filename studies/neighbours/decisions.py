"""Decisions that last several cycles: frame skip, repetition and macro actions as one kind of task.

A decision is a sequence of the task's actions, one per cycle. While it is flown, nothing is
observed and nothing else can be decided (a semi-Markov decision process, Sutton et al. 1999).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.learning.network import Head
from skystack.stacking import NO_OP
from skystack.tasks.batch import choose
from skystack.tasks.contract import Outcome, Task, TaskState
from skystack.tasks.wrapper import TaskWrapper

Decision = tuple[int, ...]
"""The task's action in each cycle."""


@dataclass(frozen=True)
class Decisions(TaskWrapper[Task]):
    """A task whose step flies one decision.

    The reward is the sum of the rewards of its cycles, discounted to its first cycle.
    """

    decisions: tuple[Decision, ...]
    gamma: float

    @property
    def action_names(self) -> tuple[str, ...]:
        names = self.task.action_names
        return tuple(", ".join(names[action] for action in each) for each in self.decisions)

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """The action in each cycle of each decision, and the decisions' lengths."""
        lengths = np.array([len(each) for each in self.decisions], dtype=np.int32)
        actions = np.full((len(lengths), max(lengths)), NO_OP, dtype=np.int32)
        for row, each in zip(actions, self.decisions, strict=True):
            row[: len(each)] = each
        return actions, lengths

    def step(self, state: TaskState, action: Int[Array, "*batch"]) -> tuple[TaskState, Outcome]:
        actions, lengths = map(jnp.asarray, self._table)
        length = lengths[action]

        def cycle(
            carry: tuple[TaskState, Outcome, Array, Array], index: Int[Array, ""]
        ) -> tuple[tuple[TaskState, Outcome, Array, Array], None]:
            state, outcome, reward, steps = carry
            flying = (index < length) & ~outcome.ended
            flown, following = self.task.step(state, actions[action, index])
            discounted = self.gamma ** steps[None] * following.reward
            reward = reward + jnp.where(flying[None], discounted, 0.0)
            steps = steps + flying.astype(jnp.float32)
            return (*choose(flying, (flown, following), (state, outcome)), reward, steps), None

        _, like = jax.eval_shape(self.task.step, state, action)
        nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), like)
        none = jnp.zeros(action.shape)
        start = (state, nothing, jnp.zeros_like(nothing.reward), none)
        (state, outcome, reward, steps), _ = jax.lax.scan(
            cycle, start, jnp.arange(actions.shape[1])
        )
        return state, outcome._replace(reward=reward, steps=steps)

    def instruct(self, state: TaskState, action: Int[Array, "*batch"]) -> TaskState:
        raise NotImplementedError  # a decision is not one instruction

    def may_stack(self, state: TaskState, action: Int[Array, "*batch"]) -> Bool[Array, "*batch"]:
        raise NotImplementedError

    def advance(self, state: TaskState) -> tuple[TaskState, Outcome]:
        raise NotImplementedError


def repeated(actions: int, cycles: int) -> tuple[Decision, ...]:
    """Frame skip: each action, repeated for `cycles` cycles."""
    return tuple((action,) * cycles for action in range(actions))


def held(actions: int, cycles: int) -> tuple[Decision, ...]:
    """A longer decision interval: each action once, then the no-op."""
    return tuple((action,) + (NO_OP,) * (cycles - 1) for action in range(actions))


def repetitions(actions: int, most: int) -> tuple[Decision, ...]:
    """Each action repeated for 1 to `most` cycles, ordered by action, then by length."""
    return tuple((action,) * cycles for action in range(actions) for cycles in range(1, most + 1))


def options(actions: int, most: int) -> tuple[Decision, ...]:
    """One cycle of the no-op, and each instruction repeated for 1 to `most` cycles."""
    return ((NO_OP,), *repetitions(actions, most)[most:])


def independent_head(actions: int, most: int) -> Head:
    """FiGAR's head (Sharma et al. 2017): the number of cycles does not depend on the action."""

    def logits(outputs: Float[Array, "outputs n"]) -> Float[Array, "decisions n"]:
        action, cycles = outputs[:actions], outputs[actions:]
        return (action[:, None] + cycles[None]).reshape(actions * most, -1)

    return Head(actions + most, logits)


def conditional_head(actions: int, most: int) -> Head:
    """TempoRL's head (Biedenkapp et al. 2021): the number of cycles depends on the action."""

    def logits(outputs: Float[Array, "outputs n"]) -> Float[Array, "decisions n"]:
        action = jax.nn.log_softmax(outputs[:actions], axis=0)
        cycles = jax.nn.log_softmax(outputs[actions:].reshape(actions, most, -1), axis=1)
        return (action[:, None] + cycles).reshape(actions * most, -1)

    return Head(actions + actions * most, logits)


MakeDecisions = Callable[[int], tuple[Decision, ...]]
"""Maps the number of the task's actions to the decisions."""
MakeHead = Callable[[int], Head]
