"""What every task offers: pure functions of one scenario, or of many at once.

    reset(key) -> state                  a random scenario at cycle 0
    observe(state) -> observation        what the policy sees, each value in [0, 1]
    instruct(state, action) -> state     tell an aircraft something; no time passes
    may_stack(state, action) -> bool     whether the instruction can be given now
    advance(state) -> (state, outcome)   one radar cycle; everybody flies
    step(state, action)                  advance(instruct(state, action)): the MDP step

Given arrays with batch axes behind their own, all but `reset` compute that batch, see
`skystack.tasks.batch`, which also makes a task for one scenario take many.

Tasks never truncate by themselves: the end of a scenario is part of the task, paid and terminal.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

NO_OP = 0
"""The action that instructs nobody, in every task."""

TaskState = Any
"""Opaque to callers: a pytree of arrays."""


class Metrics(NamedTuple):
    """One scenario judged so far; final once it has ended."""

    success: Bool[Array, "*batch"]
    """Every criterion of the task, for every aircraft."""
    correct_exit: Bool[Array, "*batch"]
    """All aircraft left through their exit at their exit level."""
    excursion: Bool[Array, "*batch"]
    """Some aircraft left the sector otherwise, or never entered it."""
    few_instructions: Bool[Array, "*batch"]
    """Every aircraft was given fewer than 30."""
    instructions: Float[Array, "*batch"]
    bursts: Float[Array, "*batch"]
    """Runs of the same instruction in consecutive cycles (or within one stack)."""
    min_separation_nm: Float[Array, "*batch"]
    """Least distance of two active aircraft less than 1,000 ft apart; infinite if none were."""
    cycles: Float[Array, "*batch"]


class Outcome(NamedTuple):
    """What one cycle brought."""

    reward: Float[Array, "*batch"]
    terminated: Bool[Array, "*batch"]
    truncated: Bool[Array, "*batch"]
    metrics: Metrics


@runtime_checkable
class Task(Protocol):
    """The contract; `skystack.tasks.conformance.check_task` tests an implementation."""

    @property
    def name(self) -> str: ...

    @property
    def version(self) -> int:
        """Raised when behaviour changes: trained policies are refused then."""

    @property
    def action_names(self) -> tuple[str, ...]: ...

    @property
    def observation_names(self) -> tuple[str, ...]: ...

    def reset(self, key: PRNGKeyArray) -> TaskState: ...

    def observe(self, state: TaskState) -> Float[Array, "observation *batch"]: ...

    def instruct(self, state: TaskState, action: Int[Array, "*batch"]) -> TaskState: ...

    def may_stack(
        self, state: TaskState, action: Int[Array, "*batch"]
    ) -> Bool[Array, "*batch"]: ...

    def advance(self, state: TaskState) -> tuple[TaskState, Outcome]: ...

    def step(self, state: TaskState, action: Int[Array, "*batch"]) -> tuple[TaskState, Outcome]: ...
