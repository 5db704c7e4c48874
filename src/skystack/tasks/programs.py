"""Compiled programs of a task's functions, in objects that can be copied and pickled.

Programs are compiled on their first call. So before JAX has started, the objects can be created,
copied, pickled, and inherited by a forked process.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from skystack.compilation.forks import refuse_forked
from skystack.compilation.packing import Packed
from skystack.compilation.shared import PROGRAMS
from skystack.tasks.contract import Task, TaskState

Result = TypeVar("Result")


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
            program = PROGRAMS.get(method, (self,), self._constants)
            self._programs[name] = program
        return program(*arguments)

    return run


class TaskPrograms:
    """Base of classes whose methods are compiled, see `compiled`, and whose only state is a task.

    Objects of equal tasks share their programs, also after unpickling, if the tasks are values
    (`skystack.compilation.shared.is_value`). Copying returns the object itself. Subclasses take the
    task as their only argument.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._programs: dict[str, Callable[..., Any]] = {}

    @property
    def _constants(self) -> tuple[type, Task]:
        """What the programs depend on."""
        return type(self), self._task

    @compiled
    def unpacked(self, state: Packed) -> TaskState:
        """A state of the task that was packed."""
        return state.unpacked()

    def __copy__(self) -> "TaskPrograms":
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> "TaskPrograms":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._task,)
