"""What a task made from another one takes over from it."""

from dataclasses import dataclass
from typing import Generic, TypeVar

from skystack.tasks.contract import Task

Wrapped = TypeVar("Wrapped", bound=Task)


@dataclass(frozen=True)
class TaskWrapper(Generic[Wrapped]):
    """Names and version are the wrapped task's; policies are trained for and judged on that."""

    task: Wrapped

    @property
    def name(self) -> str:
        return self.task.name

    @property
    def version(self) -> int:
        return self.task.version

    @property
    def action_names(self) -> tuple[str, ...]:
        return self.task.action_names

    @property
    def observation_names(self) -> tuple[str, ...]:
        return self.task.observation_names
