"""Compiled programs of a task's functions, in objects that can be copied and pickled.

Programs are compiled on their first call. So before JAX has started, the objects can be created,
copied, pickled, and inherited by a forked process.
"""

from collections.abc import Callable
from functools import wraps
from types import MethodType
from typing import Any, TypeVar
from uuid import uuid4
from weakref import WeakValueDictionary

import jax

from skystack.compilation.forks import refuse_forked
from skystack.tasks.contract import Task

Result = TypeVar("Result")


class TaskPrograms:
    """Base of classes whose methods are compiled, see `compiled`, and whose only state is a task.

    Copying returns the object itself. Unpickling returns the original object if it still exists in
    the process; otherwise one new object, shared by all its pickles, which compiles again.
    Subclasses take the task as their only argument.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._programs: dict[str, Callable[..., Any]] = {}
        self._register(uuid4().hex)

    def __copy__(self) -> "TaskPrograms":
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "TaskPrograms":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickle, (type(self), self._identity, self._task)

    def _register(self, identity: str) -> None:
        self._identity = identity
        _ALIVE[identity] = self


_ALIVE: WeakValueDictionary[str, TaskPrograms] = WeakValueDictionary()


def _unpickle(kind: type[TaskPrograms], identity: str, task: Task) -> TaskPrograms:
    alive = _ALIVE.get(identity)
    if alive is None:
        alive = kind(task)
        alive._register(identity)
    return alive


def compiled(method: Callable[..., Result]) -> Callable[..., Result]:
    """Make a method of `TaskPrograms` a compiled program. Takes positional JAX or numpy arguments.

    Raises InputError in a process that was forked after JAX was started.
    """
    name = method.__name__

    @wraps(method)
    def run(self: Any, *arguments: Any) -> Any:
        refuse_forked()
        program = self._programs.get(name)
        if program is None:
            program = self._programs[name] = jax.jit(MethodType(method, self))
        return program(*arguments)

    return run
