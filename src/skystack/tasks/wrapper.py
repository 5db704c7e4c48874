"""The base class of tasks that wrap another task."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

from jaxtyping import Array, Bool, Int, PRNGKeyArray

from skystack.tasks.contract import Metric, Observation, Outcome, Task, TaskState

Wrapped = TypeVar("Wrapped", bound=Task)


@dataclass(frozen=True)
class TaskWrapper(Generic[Wrapped]):
    """Forwards everything to the wrapped task; subclasses override what they change."""

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

    def reset(self, key: PRNGKeyArray) -> TaskState:
        return self.task.reset(key)

    def observe(self, state: TaskState) -> Observation:
        return self.task.observe(state)

    def instruct(self, state: TaskState, action: Int[Array, "*batch"]) -> TaskState:
        return self.task.instruct(state, action)

    def may_stack(self, state: TaskState, action: Int[Array, "*batch"]) -> Bool[Array, "*batch"]:
        return self.task.may_stack(state, action)

    def advance(self, state: TaskState) -> tuple[TaskState, Outcome]:
        return self.task.advance(state)

    def step(self, state: TaskState, action: Int[Array, "*batch"]) -> tuple[TaskState, Outcome]:
        return self.task.step(state, action)
