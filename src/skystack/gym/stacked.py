"""Online action-stacking round any Gymnasium environment that has two phases, and any agent.

An agent's ordinary loop asks for an action at each step. Here a step takes no time for as long as
the agent asks for what it asked for first, so that the loop itself compiles the clearance. What
`skystack.stacking` does by asking a policy, this does by being asked. Needs no JAX.
"""

from copy import copy
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker

from skystack.errors import InputError
from skystack.stacking import NO_ACTION

MOST_INSTRUCTIONS = 100
"""Of one clearance. No task here can take more than 60: an aircraft sent through all levels."""

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

    While the action is the cycle's first and may be stacked, it is given: time stands still, the
    reward is 0 and the observation shows what is now cleared. Any other action is not executed; it
    ends the clearance, and one cycle is flown. `info["clearance"]` of that step says what was
    issued: `action`, given so many times: `instructions`; 0, and `no_action`, if nothing was.

    `limit` is the most instructions of one clearance (1 issues each by itself), so that an agent
    that never changes its mind cannot stop time. Actions are numbers or arrays.

    Other wrappers go outside, round this one: it must reach the two phases. Raises InputError where
    one is inside, or there are no two phases.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        limit: int = MOST_INSTRUCTIONS,
        no_action: Any = NO_ACTION,
    ) -> None:
        RecordConstructorArgs.__init__(self, limit=limit, no_action=no_action)
        super().__init__(env)
        if limit < 1:
            raise InputError(f"limit is {limit} (allowed: 1 or more)")
        self._phases = _phases_of(env)
        self._limit, self._no_action = limit, no_action
        self._action, self._instructions = no_action, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        self._begin_cycle()
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Give one more instruction, or else fly one cycle."""
        if self._goes_on(action):
            self._phases.instruct(action)
            # A copy: agents may write their next action over this one.
            self._action, self._instructions = copy(action), self._instructions + 1
            return self._phases.observe(), 0.0, False, False, {}
        clearance = {"action": self._action, "instructions": self._instructions}
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

    def _goes_on(self, action: Any) -> bool:
        same = not self._instructions or np.array_equal(action, self._action)
        wanted = same and not np.array_equal(action, self._no_action)
        return wanted and self._instructions < self._limit and self._phases.may_stack(action)


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
