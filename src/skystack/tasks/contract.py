"""The contract of a task: pure functions of one scenario, or of a batch of scenarios.

    reset(key) -> state                  a random scenario at cycle 0
    observe(state) -> observation        the policy's observation: a pytree of values in [0, 1]
    instruct(state, action) -> state     change a cleared value; no simulated time passes
    may_stack(state, action) -> bool     whether the instruction can be issued now
    advance(state) -> (state, outcome)   one radar cycle; all aircraft fly
    step(state, action)                  advance(instruct(state, action)): the MDP step

All functions except `reset` also accept arrays with additional batch axes at the end and compute
the whole batch; see `skystack.tasks.batch`, which also adapts tasks written for one scenario.

A `Task` can be trained on. A `TrafficTask` also exposes its aircraft: it can be evaluated, run on
other platforms, replayed and reported. Tasks are found by name in `skystack.tasks.registry`. Action
0, `skystack.stacking.NO_OP`, instructs no aircraft in any task.
"""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from skystack.airspace.sector import Sector
from skystack.simulator.fleet import AircraftType
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import Traffic

TaskState = Any
"""Opaque to callers: a pytree of arrays."""
Observation = Any
"""A pytree of arrays, or a single array `[observation, *batch]`."""
Metrics = Mapping[str, Array]
"""The values of a task's metrics by name, each `[*batch]`."""

Kind = Literal["heading", "level"]
"""What an instruction changes: the cleared heading or the cleared level."""


class Action(NamedTuple):
    """The meaning of one action number."""

    name: str
    """A readable name; "none" for action 0, which instructs no aircraft."""
    aircraft: int | None = None
    """Index of the addressed aircraft."""
    kind: Kind | None = None
    change: int = 0
    """The change in degrees to the right or in flight levels up."""


class Metric(NamedTuple):
    """The specification of a metric."""

    unit: str
    """The unit: `true or false`, `count`, `NM`, ..."""
    description: str


class Outcome(NamedTuple):
    """The result of one cycle. The paper's tasks have one agent, which controls all aircraft."""

    reward: Float[Array, "agents *batch"]
    terminated: Bool[Array, "agents *batch"]
    """The agent's episode has ended, and its value afterwards is 0."""
    truncated: Bool[Array, "agents *batch"]
    """The agent's episode was cut short. Never together with `terminated`."""
    ended: Bool[Array, "*batch"]
    """The scenario has ended for all agents."""
    metrics: Metrics
    """The metrics of the scenario so far. They are final once it has ended."""
    steps: Float[Array, "*batch"] | None = None
    """The number of time steps taken; None means one. Later rewards are discounted by gamma to this
    power."""


@runtime_checkable
class Task(Protocol):
    """The contract; `skystack.tasks.conformance.check_task` tests an implementation."""

    @property
    def name(self) -> str: ...

    @property
    def version(self) -> int:
        """Increased when behaviour changes. Policies trained for another version are refused."""

    @property
    def agents(self) -> int:
        """The number of agents, which is the length of the first axis of rewards and ends."""

    @property
    def action_names(self) -> tuple[str, ...]: ...

    @property
    def observation_names(self) -> tuple[str, ...]:
        """A name for each value of the flattened observation."""

    @property
    def metrics(self) -> Mapping[str, Metric]:
        """The specification of each metric of an outcome, by name."""

    def reset(self, key: PRNGKeyArray) -> TaskState: ...

    def observe(self, state: TaskState) -> Observation: ...

    def instruct(self, state: TaskState, action: Int[Array, "*batch"]) -> TaskState: ...

    def may_stack(
        self, state: TaskState, action: Int[Array, "*batch"]
    ) -> Bool[Array, "*batch"]: ...

    def advance(self, state: TaskState) -> tuple[TaskState, Outcome]: ...

    def step(self, state: TaskState, action: Int[Array, "*batch"]) -> tuple[TaskState, Outcome]: ...

    # Optional, for training with `timing = "stack"`: `end_burst(state) -> state`, after which the
    # next instruction starts a new burst.


@runtime_checkable
class ManyAgents(Task, Protocol):
    """A task with several agents that share one policy.

    Observations are `[observation, agents, *batch]`, actions `[agents, *batch]`.
    """

    def active(self, state: TaskState) -> Bool[Array, "agents *batch"]:
        """Which agents take a decision now."""

    def waiting(self, state: TaskState) -> Bool[Array, "agents *batch"]:
        """Which other agents will decide later, in the same episode."""


class AircraftStatus(NamedTuple):
    """The status of each aircraft in the sector."""

    entered: Bool[Array, "aircraft *batch"]
    exited: Bool[Array, "aircraft *batch"]
    """It has left through its exit and is no longer observed or controlled."""
    excursion: Bool[Array, "aircraft *batch"]
    """It has left the sector other than through its exit, or never entered it."""


@runtime_checkable
class TrafficTask(Task, Protocol):
    """A task with aircraft in a sector.

    Its metrics include `correct_exit`, `excursion` and `min_separation_nm`, see
    `skystack.tasks.metrics`.
    """

    @property
    def sector(self) -> Sector: ...

    @property
    def simulator(self) -> Simulator:
        """The simulator that flies the aircraft, with its performance model."""

    @property
    def performance(self) -> str:
        """The name of the performance model."""

    @property
    def fleet(self) -> tuple[AircraftType, ...]:
        """The types of aircraft. Empty if all aircraft use the performance model `performance`."""

    @property
    def aircraft(self) -> int:
        """The number of aircraft in a scenario."""

    @property
    def cycles(self) -> int:
        """The time limit of a scenario in cycles."""

    @property
    def actions(self) -> tuple[Action, ...]:
        """The meaning of each action number, action 0 first."""

    def traffic(self, state: TaskState) -> Traffic:
        """The state of the traffic."""

    def status(self, state: TaskState) -> AircraftStatus: ...

    def exit_level_ticks(self, state: TaskState) -> Float[Array, "aircraft *batch"]:
        """The exit levels of the aircraft."""

    def with_traffic(self, state: TaskState, traffic: Traffic) -> TaskState:
        """The scenario with its traffic replaced by the initial traffic on another platform."""

    def end_cycle(self, state: TaskState, flown: Traffic) -> tuple[TaskState, Outcome]:
        """`advance` for a cycle that another platform has flown.

        `state` is the state before the cycle, `flown` the traffic after it.
        """

    def succeeded(
        self,
        metrics: Mapping[str, np.ndarray],
        clearances: Int[np.ndarray, "scenarios aircraft"],
    ) -> Bool[np.ndarray, " scenarios"]:
        """Which scenarios succeeded, with clearances counted instead of instructions."""
