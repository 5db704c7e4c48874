"""The base class of tasks that wrap another task."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from skystack.tasks.contract import Metric, Task

Wrapped = TypeVar("Wrapped", bound=Task)


@dataclass(frozen=True)
class TaskWrapper(Generic[Wrapped]):
    """Forwards names, version and metrics of the wrapped task, for which policies are trained."""

    task: Wrapped

    @property
    def name(self) -> str:
        return self.task.name

    @property
    def version(self) -> int:
        return self.task.version

    @property
    def agents(self) -> int:
        return self.task.agents

    @property
    def metrics(self) -> Mapping[str, Metric]:
        return self.task.metrics

    @property
    def action_names(self) -> tuple[str, ...]:
        return self.task.action_names

    @property
    def observation_names(self) -> tuple[str, ...]:
        return self.task.observation_names
