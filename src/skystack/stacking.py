"""Online action-stacking: compile a policy's burst of identical instructions into one clearance.

While simulated time is frozen, the policy is queried repeatedly. Each query sees the cleared value
that results from the previous instruction. The burst continues as long as the policy returns the
same instruction. The burst is then compiled into one clearance, and one cycle is flown (section
"Online Action-Stacking" of the paper). This is unrelated to stacking past actions into an
observation.

The policy is queried only if its action can be used: not at the limit, and not when the instruction
cannot be repeated. With a limit of 1, even a stateful policy is queried once per cycle, as without
stacking.

This module depends on policies and two-phase environments only. `stack` runs in plain Python, with
any array library; `stack_traced` runs inside `jax.jit`; `stack_many` handles many scenarios with a
policy that runs outside `jax.jit`, and `stack_many_traced` many scenarios inside it.
"""

from collections.abc import Callable
from copy import deepcopy
from operator import eq
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

from skystack.errors import InputError, checked_integer

State = TypeVar("State")
Carry = TypeVar("Carry")

NO_OP = 0
"""The action that instructs no aircraft, in every task."""

ENDLESS = 1000
"""The number of instructions at which a stack without a limit counts as endless. It is far more
than any task here allows."""


@runtime_checkable
class TwoPhase(Protocol[State]):
    """An environment in which issuing an instruction takes no simulated time.

    `instruct` must not change any physical state. `may_stack` returns whether an instruction can be
    issued in a state: not to an aircraft that has left, and not beyond a limit of the clearance.

    If the environment also has a method `checked_action(action)`, `stack` passes every action of
    the policy through it. It returns the action, or raises if the action is not in the table.

    Example:

        >>> import skystack
        >>> class Dial:
        ...     def observe(self, state):
        ...         return state
        ...     def instruct(self, state, action):
        ...         return state + action
        ...     def may_stack(self, state, action):
        ...         return state < 10
        >>> isinstance(Dial(), skystack.TwoPhase)
        True
    """

    def observe(self, state: State) -> Any: ...

    def instruct(self, state: State, action: Any) -> State: ...

    def may_stack(self, state: State, action: Any) -> Any: ...


class Stack(NamedTuple):
    """The burst from which one clearance is compiled.

    Example:

        >>> import skystack
        >>> issued = skystack.Stack(action=1, instructions=7)  # "left 10", seven times
        >>> 10 * issued.instructions  # one clearance: left by 70 degrees
        70
    """

    action: Any
    """The repeated instruction: the policy's first action in the cycle."""
    instructions: Any
    """The number of times it was issued in this cycle. 0 means that there is no clearance."""


def belongs(
    action: Any, stack: Stack, same: Callable[[Any, Any], Any] = eq, no_op: Any = NO_OP
) -> Any:
    """Whether an action starts or continues a stack: the rule of online action-stacking.

    Any instruction starts an empty stack; only the same instruction continues it. An action that
    belongs to the stack is executed if `may_stack` allows it. Any other action ends the stack and
    is not executed. Works elementwise on arrays of actions; pass `same` for actions that are arrays
    themselves.
    """
    empty = stack.instructions == 0
    starts, continues = same(action, no_op) ^ True, same(action, stack.action)
    return (empty & starts) | ((empty ^ True) & continues)


When = Callable[[Any, Callable[[Any], Any], Any], Any]
"""`function(value)` if a condition is true, otherwise `value`: (condition, function, value)."""


def owned(answer: Any) -> Any:
    """The action, copied if it is mutable: a policy may return the same array for every query."""
    mutable = hasattr(answer, "__array__") or isinstance(answer, list | tuple | dict)
    return deepcopy(answer) if mutable else answer


def checked_limit(limit: Any) -> int:
    """The limit as an int. Raises InputError unless it is a whole number of at least 1."""
    return checked_integer("limit", limit, 1)


def stack(
    environment: TwoPhase[State],
    policy: Callable[[Any], Any],
    state: State,
    limit: int | None = None,
) -> tuple[State, Stack]:
    """Issue the policy's instruction for as long as it repeats it. No simulated time passes.

    `policy` maps an observation to an action; it may use any library. `limit` is the maximum number
    of instructions per clearance; with 1, every instruction is a clearance by itself.

    Returns the instructed state, ready to be advanced one cycle, and the stack. Raises InputError
    for a limit below 1, and for an endless stack: without a limit, the policy repeats the same
    instruction and `may_stack` always allows it.

    Example:

        >>> import skystack
        >>> class Dial:
        ...     def observe(self, state):
        ...         return state
        ...     def instruct(self, state, action):
        ...         return state + action
        ...     def may_stack(self, state, action):
        ...         return state < 10
        >>> skystack.stack(Dial(), lambda dial: 1 if dial < 5 else 0, 2)
        (5, Stack(action=1, instructions=3))
    """
    checked = getattr(environment, "checked_action", lambda action: action)

    def query(state: State, _number: Any, _mask: Any) -> Any:
        return checked(owned(policy(environment.observe(state))))

    burst = _Burst(environment, query, _when, _while, _most(limit))
    instructed_state, issued = burst.compile(state, Stack(None, 0), asking=True)
    if limit is None and issued.instructions >= ENDLESS:
        raise InputError(
            f"endless stack: the policy returned action {issued.action} {ENDLESS} times in one "
            "cycle, and may_stack allows more (allowed: a limit, or a may_stack that ends the "
            "stack)"
        )
    return instructed_state, issued


def stack_traced(
    environment: TwoPhase[State],
    policy: Callable[[Any, Any], Any],
    state: State,
    key: Any,
    limit: Any = None,
) -> tuple[State, Stack]:
    """`stack` for compiled programs: `policy` maps an observation and a random key to an action.

    Every query gets its own key, so a stochastic policy draws a new sample each time. A compiled
    program cannot raise: without a limit, a stack ends at `ENDLESS` instructions, and a limit that
    is an argument of the program is not checked. Under `jax.vmap` a query is computed for every
    scenario, even if its action is not used.
    """
    import jax  # noqa: PLC0415  (`stack` does not need JAX)
    import jax.numpy as jnp  # noqa: PLC0415

    @jax.jit  # traced only once, although its result's shape is needed first
    def query(state: State, number: Any, _mask: Any) -> Any:
        return policy(environment.observe(state), jax.random.fold_in(key, number))

    def when(condition: Any, function: Callable[[Any], Any], value: Any) -> Any:
        return jax.lax.cond(condition, function, lambda value: value, value)

    burst = _Burst(environment, query, when, jax.lax.while_loop, _traced_most(limit))
    none, asking = jnp.zeros((), dtype=jnp.int32), jnp.ones((), dtype=bool)
    shapes = jax.eval_shape(query, state, none, asking)
    no_action = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
    return burst.compile(state, Stack(no_action, none), asking)


class ManyTwoPhase(TwoPhase[State], Protocol[State]):
    """Many scenarios at once: actions and the results of `may_stack` are arrays `[scenarios]`."""

    def choose(self, condition: Any, yes: Any, no: Any) -> Any:
        """Select from two pytrees of arrays, scenario by scenario."""


def stack_many(
    environment: ManyTwoPhase[State],
    policy: Callable[[Any, Any, Any], Any],
    state: State,
    asking: Any,
    limit: int | None = None,
) -> tuple[State, Stack]:
    """`stack` for many scenarios at once, with a policy in plain Python.

    `policy` gets the observations, a mask `[scenarios]` of the scenarios that need an action, and
    the index of each scenario's query in this cycle. It returns an action for every scenario,
    `NO_OP` outside the mask. `asking` is the initial mask. Without a limit, a stack ends at
    `ENDLESS` instructions.
    """
    import numpy as np  # noqa: PLC0415  (importing skystack loads no heavy library)

    def query(state: State, number: Any, mask: Any) -> Any:
        return owned(policy(environment.observe(state), mask, number))

    def when(condition: Any, function: Callable[[Any], Any], value: Any) -> Any:
        if not condition.any():
            return value
        if condition.all():
            return function(value)
        choose = np.where if isinstance(value, np.ndarray) else environment.choose
        return choose(condition, function(value), value)

    def while_any(
        condition: Callable[[Carry], Any], body: Callable[[Carry], Carry], carry: Carry
    ) -> Carry:
        return _while(lambda carry: condition(carry).any(), body, carry)

    burst = _Burst(environment, query, when, while_any, _most(limit))
    return burst.compile(state, Stack(asking * NO_OP, asking * 0), asking)


def stack_many_traced(
    environment: ManyTwoPhase[State],
    policy: Callable[[Any, Any, Any], Any],
    state: State,
    asking: Any,
    limit: Any = None,
) -> tuple[State, Stack]:
    """`stack_many` for compiled programs: `policy` returns an action for every scenario, in int32.

    Actions outside the mask are not used. The limit is treated as by `stack_traced`.
    """
    import jax  # noqa: PLC0415  (`stack` does not need JAX)
    import jax.numpy as jnp  # noqa: PLC0415

    def query(state: State, number: Any, mask: Any) -> Any:
        return policy(environment.observe(state), mask, number)

    def when(condition: Any, function: Callable[[Any], Any], value: Any) -> Any:
        return environment.choose(condition, function(value), value)

    def while_any(
        condition: Callable[[Carry], Any], body: Callable[[Carry], Carry], carry: Carry
    ) -> Carry:
        last: Carry = jax.lax.while_loop(lambda carry: jnp.any(condition(carry)), body, carry)
        return last

    burst = _Burst(environment, query, when, while_any, _traced_most(limit))
    none = jnp.zeros(asking.shape, dtype=jnp.int32)
    return burst.compile(state, Stack(none + NO_OP, none), asking)


def _traced_most(limit: Any) -> Any:
    """`_most` in a compiled program. A limit that is an argument of the program is not checked."""
    import jax  # noqa: PLC0415  (`stack` does not need JAX)

    return limit if isinstance(limit, jax.core.Tracer) else _most(limit)


def _most(limit: Any) -> int:
    """The maximum number of instructions with a limit or without one."""
    return ENDLESS if limit is None else checked_limit(limit)


def _when(condition: Any, function: Callable[[Any], Any], value: Any) -> Any:
    return function(value) if condition else value


def _while(
    condition: Callable[[Carry], Any], body: Callable[[Carry], Carry], carry: Carry
) -> Carry:
    while condition(carry):
        carry = body(carry)
    return carry


class _LoopState(NamedTuple):
    """The variables of the loop over the queries of a burst."""

    state: Any
    stack: Stack
    asking: Any
    """Whether the policy is queried again."""


class _Burst(NamedTuple):
    """The algorithm, shared by plain and traced loops, over one scenario or many."""

    environment: Any
    query: Callable[[Any, Any, Any], Any]
    """Maps a state, the index of the query and a mask of scenarios to an action."""
    when: When
    while_loop: Callable[[Callable[[Any], Any], Callable[[Any], Any], Any], Any]
    most: Any
    """The maximum number of instructions."""

    def compile(self, state: Any, stack: Stack, asking: Any) -> tuple[Any, Stack]:
        """The instructed state and its stack. `stack` is empty; `asking` is the initial mask."""
        start = _LoopState(state, stack, asking)
        end = self.while_loop(lambda loop: loop.asking, self._ask, start)
        return end.state, end.stack

    def _ask(self, loop: _LoopState) -> _LoopState:
        """Query the policy, and issue its instruction if it belongs to the stack.

        The query is in one place only: in a compiled program it is the largest part.
        """
        count = loop.stack.instructions
        answer = self.query(loop.state, count, loop.asking)
        first = loop.asking & (count == 0)
        action = self.when(first, lambda _: answer, loop.stack.action)

        def allowed(state: Any, condition: Any) -> Any:
            return self.when(
                condition, lambda _: self.environment.may_stack(state, action), condition
            )

        fits = loop.asking & belongs(answer, Stack(action, count))
        # Whether a repetition is allowed has been checked before the query.
        issues = (fits & (count > 0)) | allowed(loop.state, fits & first)
        state = self.when(
            issues, lambda state: self.environment.instruct(state, action), loop.state
        )
        count = self.when(issues, lambda count: count + 1, count)
        repeatable = allowed(state, issues & (count < self.most))
        return _LoopState(state, Stack(action, count), repeatable)
