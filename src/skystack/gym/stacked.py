"""Online action-stacking round any Gymnasium environment that has two phases, and any agent.

An agent's ordinary loop asks for an action at each step. Here a step takes no time for as long as
the agent asks for what it asked for first, so that the loop itself compiles the clearance. What
`skystack.stacking` does by asking a policy, this does by being asked. Needs no JAX.
"""

from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker

from skystack.errors import InputError
from skystack.stacking import NO_OP, checked_limit, owned

MOST_INSTRUCTIONS = 100
"""Of one clearance. No task here can take more than 60: an aircraft sent through all levels."""

_NUMBERS = (spaces.Box, spaces.Discrete, spaces.MultiBinary, spaces.MultiDiscrete)
PASSED_BY = (OrderEnforcing, PassiveEnvChecker)
"""Wrappers of `gymnasium.make` that only check: nothing is lost by going past them."""


@runtime_checkable
class TwoPhaseEnvironment(Protocol):
    """A Gymnasium environment in which telling takes no time; its `step` is one of each.

    `instruct` must leave everything physical as it is. `may_stack` says whether an instruction can
    be given now. Both take actions of the action space.
    """

    def observe(self) -> Any: ...

    def may_stack(self, action: Any) -> bool: ...

    def instruct(self, action: Any) -> None: ...

    def advance(self) -> tuple[float, bool, bool, dict[str, Any]]:
        """One cycle: (reward, terminated, truncated, info)."""


class StackedEnvironment(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Steps that take no time while a clearance is being compiled.

    While the action equals the cycle's first and may be stacked, it is given: time stands still,
    the reward is 0 and the observation shows what is now cleared. Any other action is not executed;
    it ends the clearance, and one cycle is flown. If the action cannot be given again, the cycle is
    flown in the same step: the agent is not asked for an action that could not be used.
    `info["clearance"]` of the step that flies holds the `action` issued and the number of
    `instructions`, or `no_op` and 0.

    `limit` is the most instructions of one clearance, so that an agent that never changes its mind
    cannot stop time. With a limit of 1 every step flies, as without this wrapper. Actions are
    numbers or arrays. Raises InputError for one that is neither in the action space nor
    `no_op`.

    Other wrappers go outside, round this one: it must reach the two phases. Raises InputError where
    one is inside, or there are no two phases.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        limit: int = MOST_INSTRUCTIONS,
        no_op: Any = NO_OP,
    ) -> None:
        RecordConstructorArgs.__init__(self, limit=limit, no_op=no_op)
        super().__init__(env)
        self._limit, self._no_action = checked_limit(limit), owned(no_op)
        self._phases = _phases_of(env)
        self._action, self._instructions = self._no_action, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        self._begin_cycle()
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Give an instruction that starts or continues the stack; fly a cycle once it has ended."""
        wanted = self._wanted(self._checked(action))
        if wanted:
            self._action, self._instructions = owned(action), self._instructions + 1
            self._phases.instruct(owned(action))
        if wanted and self._instructions < self._limit and self._phases.may_stack(self._action):
            return self._phases.observe(), 0.0, False, False, {}
        clearance = {"action": owned(self._action), "instructions": self._instructions}
        reward, terminated, truncated, info = self._phases.advance()
        self._begin_cycle()
        return (
            self._phases.observe(),
            reward,
            terminated,
            truncated,
            info | {"clearance": clearance},
        )

    def _begin_cycle(self) -> None:
        self._action, self._instructions = self._no_action, 0

    def _checked(self, action: Any) -> Any:
        if not np.array_equal(action, self._no_action) and not _in(self.action_space, action):
            raise InputError(f"action is {action!r} (allowed: {self.action_space})")
        return action

    def _wanted(self, action: Any) -> bool:
        """Whether to give the action. `may_stack` was already asked about a repetition."""
        if self._instructions:
            return np.array_equal(action, self._action)
        return not np.array_equal(action, self._no_action) and self._phases.may_stack(action)


def _in(space: spaces.Space[Any], action: Any) -> bool:
    """Whether an action, an array of any library and precision, is in a space."""
    if not isinstance(space, _NUMBERS):
        return space.contains(action)
    whole = np.issubdtype(space.dtype, np.integer)
    try:
        numbers = np.asarray(action)
        with np.errstate(over="ignore", invalid="ignore"):
            cast = numbers.astype(space.dtype)
    except (OverflowError, TypeError, ValueError):  # words, or rows of several lengths
        return False
    exact = numbers.dtype.kind in "biu" and np.array_equal(cast, numbers)
    return (exact or (numbers.dtype.kind in "biuf" and not whole)) and space.contains(cast)


def _phases_of(env: gymnasium.Env[Any, Any]) -> TwoPhaseEnvironment:
    between = env
    while isinstance(between, gymnasium.Wrapper):
        if not isinstance(between, PASSED_BY):
            name = type(between).__name__
            raise InputError(
                f"{name} is inside StackedEnvironment, which would go past it (allowed: {name} "
                "round StackedEnvironment)"
            )
        between = between.env
    if not isinstance(between, TwoPhaseEnvironment):
        needed = ("observe", "may_stack", "instruct", "advance")
        missing = ", ".join(name for name in needed if not hasattr(between, name))
        raise InputError(
            f"{type(between).__name__} cannot be stacked: it lacks {missing} "
            "(see skystack.gym.stacked.TwoPhaseEnvironment)"
        )
    return between
