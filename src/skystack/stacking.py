"""Online action-stacking: compile a policy's burst of equal instructions into one clearance.

While physical time stands still the policy is asked again and again, each time seeing the cleared
value that its last instruction led to, for as long as it answers with the same instruction. What it
asked for is issued as one clearance; then one cycle is flown. (Section "Online Action-Stacking" of
the paper.) Not to be confused with stacking past actions into an observation.

A policy is asked only if its answer can be used: not at the limit, nor when the instruction cannot
be given again. So with a limit of one, even a policy with memory is asked once a cycle, as without
stacking.

This module knows policies and two-phase environments and nothing else. `stack` works with anything
that computes; `stack_traced` does the same inside `jax.jit`, and `stack_many` for many scenarios
whose policy runs outside it.
"""

from collections.abc import Callable
from copy import deepcopy
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

from skystack.errors import InputError, checked_whole

State = TypeVar("State")
Carry = TypeVar("Carry")

NO_OP = 0
"""The action that instructs nobody."""

ENDLESS = 1000
"""Instructions of one clearance at which a stack without a limit is held to have no end: far more
than any task here can take."""


@runtime_checkable
class TwoPhase(Protocol[State]):
    """An environment in which telling takes no time.

    `instruct` must leave everything physical as it is. `may_stack` says whether an instruction can
    be given in a state: not to somebody who is gone, nor beyond a limit of the clearance.

    Where it has `checked_action(action)` as well, `stack` passes every answer of the policy through
    it: it returns the action, or raises for one that is not in its table.
    """

    def observe(self, state: State) -> Any: ...

    def instruct(self, state: State, action: Any) -> State: ...

    def may_stack(self, state: State, action: Any) -> Any: ...


class Stack(NamedTuple):
    """What one clearance was compiled from."""

    action: Any
    """The instruction asked for first."""
    instructions: Any
    """How often it was given in this cycle; 0: nothing is issued."""


Both = Callable[[Any, Callable[[Any], Any]], Any]
"""Logical and. The second operand is a function of the first, called only if the first is true."""


def owned(answer: Any) -> Any:
    """A copy of a mutable answer: policies may reuse one array for all of theirs."""
    mutable = hasattr(answer, "__array__") or isinstance(answer, list | tuple | dict)
    return deepcopy(answer) if mutable else answer


def checked_limit(limit: Any) -> int:
    """The most instructions of one clearance. Raises InputError for anything but 1, 2, ..."""
    return checked_whole("limit", limit, 1)


def stack(
    environment: TwoPhase[State],
    policy: Callable[[Any], Any],
    state: State,
    limit: int | None = None,
) -> tuple[State, Stack]:
    """Instruct as long as the policy asks for the same thing; no time passes.

    `policy` maps an observation to an action: a function of any library. `limit` is the most
    instructions of one clearance, 1 to issue each by itself.

    Returns the instructed state, ready to be advanced one cycle, and what was issued. Raises
    InputError for a limit below 1, and for a stack without end: no limit, a policy that never
    changes its mind, and an environment that allows it.
    """
    checked = getattr(environment, "checked_action", lambda action: action)

    def ask(state: State, _number: Any, _who: Any) -> Any:
        return checked(owned(policy(environment.observe(state))))

    burst = _Burst(environment, ask, _both, _while, limit)
    told, issued = burst.compile(state, zero=0, asking=True)
    if limit is None and issued.instructions >= ENDLESS:
        raise InputError(
            f"an endless stack: the policy has asked for action {issued.action} {ENDLESS} times in "
            "one cycle, and may_stack allows more (allowed: a limit, or a may_stack that says no)"
        )
    return told, issued


def stack_traced(
    environment: TwoPhase[State],
    policy: Callable[[Any, Any], Any],
    state: State,
    key: Any,
    limit: int | None = None,
) -> tuple[State, Stack]:
    """`stack` for compiled programs: `policy` maps an observation and a random key to an action.

    Every query has a key of its own, so that a policy that samples samples anew. A compiled program
    cannot raise: without a limit a stack ends at `ENDLESS` instructions. Under `jax.vmap` a query
    is computed for every scenario, even if its answer is not used.
    """
    import jax  # noqa: PLC0415  (plain callables need no JAX)
    import jax.numpy as jnp  # noqa: PLC0415

    def ask(state: State, number: Any, _who: Any) -> Any:
        return policy(environment.observe(state), jax.random.fold_in(key, number))

    def both(first: Any, second: Callable[[Any], Any]) -> Any:
        return jax.lax.cond(first, second, lambda first: first, first)

    burst = _Burst(environment, ask, both, jax.lax.while_loop, limit)
    return burst.compile(state, jnp.zeros((), dtype=jnp.int32), jnp.ones((), dtype=bool))


class ManyTwoPhase(TwoPhase[State], Protocol[State]):
    """Many scenarios at once: actions and `may_stack` are arrays `[scenarios]`."""

    def choose(self, condition: Any, yes: Any, no: Any) -> Any:
        """One of two trees of arrays, scenario by scenario."""


def stack_many(
    environment: ManyTwoPhase[State],
    policy: Callable[[Any, Any, Any], Any],
    state: State,
    asking: Any,
    limit: int | None = None,
) -> tuple[State, Stack]:
    """`stack` for many scenarios at once, with a policy in plain Python.

    `policy` maps observations, the scenarios that still ask (a mask `[scenarios]`) and the number
    of each one's query in this cycle to an action for every scenario, `NO_OP` for the others.
    `asking` masks the scenarios to begin with. Without a limit a stack ends at `ENDLESS`.
    """

    def ask(state: State, number: Any, who: Any) -> Any:
        return owned(policy(environment.observe(state), who, number))

    def both(first: Any, second: Callable[[Any], Any]) -> Any:
        return first & second(first) if first.any() else first

    def while_any(
        condition: Callable[[Carry], Any], body: Callable[[Carry], Carry], carry: Carry
    ) -> Carry:
        while (going := condition(carry)).any():
            carry = environment.choose(going, body(carry), carry)
        return carry

    burst = _Burst(environment, ask, both, while_any, limit)
    return burst.compile(state, asking * 0, asking)


def _both(first: Any, second: Callable[[Any], Any]) -> bool:
    return bool(first) and bool(second(first))


def _while(
    condition: Callable[[Carry], Any], body: Callable[[Carry], Carry], carry: Carry
) -> Carry:
    while condition(carry):
        carry = body(carry)
    return carry


class _Given(NamedTuple):
    """A clearance under way."""

    state: Any
    instructions: Any
    wanted: Any
    """Whether the policy wants one more instruction."""


class _Burst(NamedTuple):
    """The algorithm: for one scenario in Python, for one inside `jax.jit`, or for many."""

    environment: Any
    ask: Callable[[Any, Any, Any], Any]
    """Maps a state, the number of the query and a mask of scenarios to an action."""
    both: Both
    while_loop: Callable[[Callable[[Any], Any], Callable[[Any], Any], Any], Any]
    limit: int | None

    def compile(self, state: Any, zero: Any, asking: Any) -> tuple[Any, Stack]:
        most = ENDLESS if self.limit is None else checked_limit(self.limit)
        action = self.ask(state, zero, asking)

        def allowed(state: Any, when: Any) -> Any:
            return self.both(when, lambda _: self.environment.may_stack(state, action))

        def give(given: _Given) -> _Given:
            told, count = self.environment.instruct(given.state, action), given.instructions + 1
            useful = allowed(told, given.wanted & (count < most))
            again = self.both(useful, lambda who: self.ask(told, count, who) == action)
            return _Given(told, count, again)

        first = _Given(state, zero, allowed(state, asking & (action != NO_OP)))
        given = self.while_loop(lambda given: given.wanted, give, first)
        return given.state, Stack(action, given.instructions)
