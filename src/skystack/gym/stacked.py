"""Online action-stacking around any Gymnasium environment with two phases, for any agent.

An agent's ordinary loop calls `step` with one action at a time. Here a step takes no simulated time
as long as the agent repeats its first action, so that the loop itself compiles the clearance.
`skystack.stacking` calls the policy; this wrapper is called by the agent. Needs no JAX.
"""

from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker

from skystack.errors import InputError
from skystack.stacking import NO_OP, Stack, belongs, checked_limit, owned

DEFAULT_LIMIT = 100
"""The default limit of one clearance. The shipped tasks never allow more than 60, which takes an
aircraft through all levels."""

_NUMBERS = (spaces.Box, spaces.Discrete, spaces.MultiBinary, spaces.MultiDiscrete)
BYPASSED_WRAPPERS = (OrderEnforcing, PassiveEnvChecker)
"""Wrappers of `gymnasium.make` that only check, and can be bypassed."""


@runtime_checkable
class TwoPhaseEnvironment(Protocol):
    """A Gymnasium environment whose `step` is one `instruct`, then one `advance`.

    `instruct` takes no time and must not change anything physical. `may_stack` returns whether an
    instruction can be issued now. Both take actions of the action space.
    """

    def observe(self) -> Any: ...

    def may_stack(self, action: Any) -> bool: ...

    def instruct(self, action: Any) -> None: ...

    def advance(self) -> tuple[float, bool, bool, dict[str, Any]]:
        """One cycle: (reward, terminated, truncated, info)."""


class StackedEnvironment(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """A wrapper whose steps take no time while a clearance is being compiled.

    While the action equals the cycle's first action and may be stacked, it is issued: no time
    passes, the reward is 0 and the observation shows the new cleared value. Any other action is not
    executed; it ends the clearance, and one cycle is flown. If the action cannot be issued again,
    the cycle is flown in the same step, so that the agent never chooses an action that cannot be
    used. `info["clearance"]` of a step that flies holds the issued `action` and its number of
    `instructions`, or `no_op` and 0.

    `limit` is the maximum number of instructions in one clearance, so that an agent that always
    repeats an action cannot stop time. With a limit of 1 every step flies, as without this wrapper.
    Actions are numbers or arrays. Raises InputError for an action that is neither in the action
    space nor `no_op`.

    Other wrappers go outside this one, which needs direct access to the two phases. Raises
    InputError if a wrapper is inside, or if the environment lacks the two phases.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        limit: int = DEFAULT_LIMIT,
        no_op: Any = NO_OP,
    ) -> None:
        RecordConstructorArgs.__init__(self, limit=limit, no_op=no_op)
        super().__init__(env)
        self._limit, self._no_op = checked_limit(limit), owned(no_op)
        self._phases = _phases_of(env)
        self._stack = Stack(self._no_op, 0)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        self._begin_cycle()
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Issue an instruction that starts or continues the stack; fly a cycle when it ends."""
        stacks = self._stacks(self._checked(action))
        if stacks:
            self._stack = Stack(owned(action), self._stack.instructions + 1)
            self._phases.instruct(owned(action))
        issued, count = self._stack
        if stacks and count < self._limit and self._phases.may_stack(issued):
            return self._phases.observe(), 0.0, False, False, {}
        clearance = {"action": owned(issued), "instructions": count}
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
        self._stack = Stack(self._no_op, 0)

    def _checked(self, action: Any) -> Any:
        if not np.array_equal(action, self._no_op) and not _in(self.action_space, action):
            raise InputError(f"action is {action!r} (allowed: {self.action_space})")
        return action

    def _stacks(self, action: Any) -> bool:
        """Whether to issue the action. For a repetition, the previous step checked `may_stack`."""
        if not belongs(action, self._stack, np.array_equal, self._no_op):
            return False
        return self._stack.instructions > 0 or self._phases.may_stack(action)


def _in(space: spaces.Space[Any], action: Any) -> bool:
    """Whether a space contains an action, which may be an array of any library and precision."""
    if not isinstance(space, _NUMBERS):
        return space.contains(action)
    whole = np.issubdtype(space.dtype, np.integer)
    try:
        numbers = np.asarray(action)
        with np.errstate(over="ignore", invalid="ignore"):
            cast = numbers.astype(space.dtype)
    except (OverflowError, TypeError, ValueError):  # text, or rows of different lengths
        return False
    exact = numbers.dtype.kind in "biu" and np.array_equal(cast, numbers)
    return (exact or (numbers.dtype.kind in "biuf" and not whole)) and space.contains(cast)


def _phases_of(env: gymnasium.Env[Any, Any]) -> TwoPhaseEnvironment:
    inner = env
    while isinstance(inner, gymnasium.Wrapper):
        if not isinstance(inner, BYPASSED_WRAPPERS):
            name = type(inner).__name__
            raise InputError(
                f"{name} is inside StackedEnvironment, which would bypass it (allowed: {name} "
                "outside StackedEnvironment)"
            )
        inner = inner.env
    if not isinstance(inner, TwoPhaseEnvironment):
        needed = ("observe", "may_stack", "instruct", "advance")
        missing = ", ".join(name for name in needed if not hasattr(inner, name))
        raise InputError(
            f"{type(inner).__name__} cannot be stacked: it lacks {missing} "
            "(see skystack.gym.stacked.TwoPhaseEnvironment)"
        )
    return inner
