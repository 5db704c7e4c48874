"""Online action-stacking: compile a policy's burst of equal instructions into one clearance.

While physical time stands still the policy is asked again and again, each time seeing the cleared
value that its last instruction led to, for as long as it answers with the same instruction. What it
asked for is issued as one clearance; then one cycle is flown. (Section "Online Action-Stacking" of
the paper.) Not to be confused with stacking past actions into an observation.

This module knows policies and two-phase environments and nothing else. `stack` works with anything
that computes; `stack_traced` does the same inside `jax.jit`, and `stack_many` for many scenarios
whose policy runs outside it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

from skystack.errors import InputError

State = TypeVar("State")
Carry = TypeVar("Carry")

NO_ACTION = 0
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


WhileLoop = Callable[[Callable[[Carry], Any], Callable[[Carry], Carry], Carry], Carry]


def python_while(
    condition: Callable[[Carry], Any], body: Callable[[Carry], Carry], carry: Carry
) -> Carry:
    """`jax.lax.while_loop` in plain Python."""
    while condition(carry):
        carry = body(carry)
    return carry


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
    InputError for a stack without end: no limit, a policy that never changes its mind, and an
    environment that allows it.
    """
    checked = getattr(environment, "checked_action", lambda action: action)

    def ask(state: State, _: Any) -> Any:
        return checked(policy(environment.observe(state)))

    told, issued = _Burst(environment, ask, limit, _and).compile(state, python_while, zero=0)
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
    cannot raise: without a limit a stack ends at `ENDLESS` instructions.
    """
    import jax  # noqa: PLC0415  (plain callables need no JAX)
    import jax.numpy as jnp  # noqa: PLC0415

    def ask(state: State, query: Any) -> Any:
        return policy(environment.observe(state), jax.random.fold_in(key, query))

    zero = jnp.zeros((), dtype=jnp.int32)
    burst = _Burst(environment, ask, limit, lambda first, second: first & second())
    return burst.compile(state, jax.lax.while_loop, zero)


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
    of each one's query in this cycle to an action for every scenario, `NO_ACTION` for the others.
    `asking` masks the scenarios to begin with. Without a limit a stack ends at `ENDLESS`.
    """

    def ask(state: State, query: Any) -> Any:
        return policy(environment.observe(state), asking, query)

    def while_any(
        condition: Callable[[Carry], Any], body: Callable[[Carry], Carry], carry: Carry
    ) -> Carry:
        nonlocal asking
        while (asking := asking & condition(carry)).any():
            carry = environment.choose(asking, body(carry), carry)
        return carry

    burst = _Burst(environment, ask, limit, lambda first, second: first & second())
    return burst.compile(state, while_any, asking * 0)


def _and(first: Any, second: Callable[[], Any]) -> Any:
    return first and second()


class _Asked(NamedTuple):
    state: Any
    action: Any
    wanted: Any
    instructions: Any


class _Burst(NamedTuple):
    """The algorithm: query, and while the same instruction is wanted, give it and query again."""

    environment: Any
    ask: Callable[[Any, Any], Any]
    """From a state and the number of the query to an action."""
    limit: int | None
    both: Callable[[Any, Callable[[], Any]], Any]
    """Logical and. In plain Python the second is not asked where the first says no."""

    def compile(self, state: Any, while_loop: WhileLoop[Any], zero: Any) -> tuple[Any, Stack]:
        action = self.ask(state, zero)
        asked = while_loop(self.goes_on, self.give, _Asked(state, action, action, zero))
        return asked.state, Stack(asked.action, asked.instructions)

    def goes_on(self, asked: _Asked) -> Any:
        same = (asked.wanted == asked.action) & (asked.action != NO_ACTION)
        room = asked.instructions < (ENDLESS if self.limit is None else self.limit)
        return self.both(same & room, lambda: self.environment.may_stack(asked.state, asked.action))

    def give(self, asked: _Asked) -> _Asked:
        told = self.environment.instruct(asked.state, asked.action)
        given = asked.instructions + 1
        return _Asked(told, asked.action, self.ask(told, given), given)
