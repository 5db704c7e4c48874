"""Evaluate a controller on held-out scenarios: fly them, write the tables, compute its row."""

import pickle
from collections.abc import Callable, Generator
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa

from skystack.agents.agent import Agent, agent_of, check_agent
from skystack.airspace.sectors import AnySector, sector_setting
from skystack.errors import MAX_INT, InputError, checked_integer
from skystack.evaluation.hosted import AgentController, fly_with_agent
from skystack.evaluation.paper import paper_row
from skystack.evaluation.platform_rollout import PlatformRollout, fly_on_platform
from skystack.evaluation.rollout import (
    NO_OP_CONTROLLER,
    Controller,
    Recording,
    network_controller,
    prepare,
)
from skystack.evaluation.summary import (
    RowValues,
    evaluation_folder,
    no_op_name,
    summarise,
    trained_name,
)
from skystack.evaluation.tabulate import tabulate
from skystack.io.files import AnyPath, make_folder, scratch_folder
from skystack.io.locks import delete_empty_on_failure
from skystack.io.names import as_name
from skystack.learning.experiment import (
    Experiment,
    experiment_from,
    experiment_names,
    load_experiment,
)
from skystack.learning.policy import Policy
from skystack.platforms.processes import TIME_LIMIT_S, checked_time_limit
from skystack.platforms.registry import (
    OWN,
    adoption_of,
    check_platform,
    flown_type,
    open_platform,
    platform_notes,
)
from skystack.policies.facts import check_trained_for
from skystack.simulator.limits import MAX_CYCLES
from skystack.tasks.contract import TrafficTask
from skystack.tasks.registry import build_traffic_task, check_cycles
from skystack.tasks.settings import TaskSettings

AnyExperiment = AnyPath | Experiment
"""The name of an experiment, its file (.toml) or the experiment itself."""


class Conditions(NamedTuple):
    """The conditions of an evaluation.

    Example:

        >>> import skystack
        >>> conditions = skystack.Conditions(episodes=50, stacking=False)
        >>> conditions.platform  # what is not given has its default
        'skystack'
    """

    seed: int = 0
    """The seed of the scenarios."""
    episodes: int = 1000
    stacking: bool = True
    greedy: bool = True
    platform: str = OWN
    time_limit_s: float = TIME_LIMIT_S
    """The time limit for one scenario on another platform."""
    sector: AnySector | None = None
    """The sector to fly in; by default that of the training."""
    cycles: int | None = None
    """The maximum number of cycles of a scenario; by default that of the training."""


class Evaluation(NamedTuple):
    """A row of the comparison and the scenarios that it summarises."""

    row: RowValues
    episodes: pa.Table
    clearances: pa.Table
    """Texts are dictionary-encoded: repeated texts take no memory."""
    failed: dict[int, str]
    """Scenarios that the platform did not finish, with the reason. They are in neither table."""
    notes: tuple[str, ...] = ()
    """Notes for the user: where a platform deviates from the task, and routes that take longer than
    a scenario."""


def policy_task(
    policy: Policy, sector: AnySector | None = None, cycles: int | None = None
) -> TrafficTask:
    """The task that a policy was trained for, as it is flown in an evaluation.

    The sector and the number of cycles can be replaced. Raises InputError if the task has changed
    since the policy was trained.
    """
    described = policy.description
    where = f"policy {described.experiment}-s{described.seed}"
    experiment: Experiment = experiment_from(described.config, where)
    task = build_traffic_task(_settings(experiment, sector, cycles))
    check_trained_for(task, described, where)
    return task


def agent_experiment(agent: Agent, experiment: AnyExperiment | None) -> Experiment:
    """The experiment that an agent is evaluated on.

    An export of our own policies names its experiment; all other agents need one. Raises InputError
    if it is missing.
    """
    facts = agent.facts
    if experiment is None and facts is not None and facts.experiment in experiment_names():
        experiment = facts.experiment
    if experiment is None:
        reason = f"{facts.experiment!r} is not shipped" if facts else "none was given"
        raise InputError(
            f"{agent.name} needs an experiment: {reason} (allowed: --experiment NAME or FILE.toml; "
            "in Python experiment=...)"
        )
    return experiment if isinstance(experiment, Experiment) else load_experiment(experiment)


def agent_task(
    agent: Agent,
    experiment: AnyExperiment | None,
    sector: AnySector | None = None,
    cycles: int | None = None,
) -> TrafficTask:
    """The task that an agent is evaluated on: that of its experiment.

    The sector and the number of cycles can be replaced. Raises InputError if the experiment is
    missing, or if the agent's observation or actions differ from those of the task.
    """
    experiment = agent_experiment(agent, experiment)
    task = build_traffic_task(_settings(experiment, sector, cycles))
    check_agent(agent, task, experiment.name)
    return task


def _settings(experiment: Experiment, sector: AnySector | None, cycles: int | None) -> TaskSettings:
    settings = experiment.task
    if sector is not None:
        settings = msgspec.structs.replace(settings, sector=sector_setting(sector))
    if cycles is not None:
        settings = msgspec.structs.replace(settings, cycles=cycles)
    return settings


def _paper(name: str, settings: TaskSettings, stacking: bool) -> dict[str, float] | None:
    """The paper's numbers for a row; None where the sector or the task is another one."""
    experiment = trained_name(name)
    if experiment in experiment_names() and load_experiment(experiment).task == settings:
        return paper_row(experiment, stacking)
    return None


_DEFAULT = Conditions()


def _checked(conditions: Conditions) -> Conditions:
    """The conditions as plain Python values. Raises InputError for invalid ones."""
    cycles = conditions.cycles
    return conditions._replace(
        seed=checked_integer("seed", conditions.seed, 0, MAX_INT),
        episodes=checked_integer("episodes", conditions.episodes, 1, MAX_INT),
        cycles=None if cycles is None else checked_integer("cycles", cycles, 1, MAX_CYCLES),
        stacking=_flag("stacking", conditions.stacking),
        greedy=_flag("greedy", conditions.greedy),
        time_limit_s=checked_time_limit(conditions.time_limit_s),
    )


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise InputError(f"{name} is {value!r} (allowed: True, False)")
    return bool(value)


def evaluate(
    policy: Any,
    conditions: Conditions = _DEFAULT,
    out: AnyPath | None = None,
    on_scenario: Callable[[int], None] = lambda done: None,
    *,
    experiment: AnyExperiment | None = None,
    name: str | None = None,
) -> Evaluation:
    """Fly a policy on the scenarios of an evaluation seed. `out` is the folder for evaluations.

    `policy` is the result of `find_policy` or `find_agent`; a function from an observation, float32
    `[observation]`, to an action number; a `Batched` function of many observations; or a
    Stable-Baselines3 model. Unless it is a `Policy` of skystack, it must be stateless: calls for
    different scenarios are interleaved, and other platforms call it in other processes. It also
    needs the `experiment` that it was made for, unless it names one.

    `name` is used for the row and the folder. `on_scenario` is called with the number of finished
    scenarios, and with 0 before compilation and flight begin. Raises InputError for invalid
    conditions, an unavailable platform, an experiment that does not fit, and a policy that fails or
    returns an invalid action; PlatformError if no scenario is finished.

    Example:

        >>> import skystack
        >>> policy = skystack.find_policy("lateral-best")
        >>> result = skystack.evaluate(policy, skystack.Conditions(episodes=2))
        >>> result.row["success_rate"]
        1.0
    """
    check_platform(conditions.platform)
    conditions = _checked(conditions)
    out = None if out is None else Path(out)
    if isinstance(policy, Policy):
        return _evaluate_own(policy, conditions, out, on_scenario, experiment, name)
    agent = agent_of(policy, name)
    experiment = agent_experiment(agent, experiment)
    task = agent_task(agent, experiment, conditions.sector, conditions.cycles)
    if not conditions.greedy and not agent.logits:
        raise InputError(
            f"{agent.name} has no probabilities to sample from (allowed: its greedy action)"
        )
    controller = partial(AgentController, agent, conditions.greedy)
    row_name, seed = as_name(name or agent.name), agent.facts.seed if agent.facts else 0
    settings = _settings(experiment, conditions.sector, conditions.cycles)
    paper = _paper(row_name, settings, conditions.stacking)
    return _evaluate(row_name, seed, task, controller, conditions, out, on_scenario, paper)


def _evaluate_own(
    policy: Policy,
    conditions: Conditions,
    out: Path | None,
    on_scenario: Callable[[int], None],
    experiment: AnyExperiment | None,
    name: str | None,
) -> Evaluation:
    described, task = policy.description, policy_task(policy, conditions.sector, conditions.cycles)
    if experiment is not None:
        raise InputError(
            f"{described.experiment} already names its experiment (allowed: --experiment only "
            "with policies of other libraries)"
        )
    controller = partial(network_controller, policy.actor, policy.normaliser, conditions.greedy)
    row_name = as_name(name) if name else described.experiment
    trained: Experiment = experiment_from(described.config, row_name)
    settings = _settings(trained, conditions.sector, conditions.cycles)
    paper = _paper(row_name, settings, conditions.stacking)
    return _evaluate(
        row_name, described.seed, task, controller, conditions, out, on_scenario, paper
    )


def evaluate_no_op(experiment: Experiment, conditions: Conditions, out: Path | None) -> Evaluation:
    """Evaluate the same scenarios without any instructions."""
    task = build_traffic_task(experiment.task)
    plain = conditions._replace(stacking=False)
    name = no_op_name(task.name)
    return _evaluate(name, 0, task, lambda: NO_OP_CONTROLLER, plain, out, lambda done: None)


def _evaluate(
    name: str,
    trained_seed: int,
    task: TrafficTask,
    controller: Callable[[], Controller | AgentController],
    conditions: Conditions,
    out: Path | None,
    on_scenario: Callable[[int], None],
    paper: dict[str, float] | None = None,
) -> Evaluation:
    """Fly the scenarios, make the tables, write them if a folder is given, and compute the row."""
    cycles_note = check_cycles(task)
    platform, stacking, greedy = conditions.platform, conditions.stacking, conditions.greedy
    folder = None
    if out is not None:
        folder = evaluation_folder(out, name, trained_seed, stacking, platform, greedy)
    failed = dict[int, str]()
    if platform == OWN:
        recordings = _fly_here(task, controller(), conditions, on_scenario)
    else:
        recordings = _fly_on_platform(task, controller, conditions, failed, on_scenario)
    with ExitStack() as stack:
        if out is not None:
            stack.enter_context(delete_empty_on_failure(out))
            make_folder(out)  # fails early, before the flights
        stack.enter_context(closing(recordings))
        on_scenario(0)
        flown_as, adoption = partial(flown_type, platform), adoption_of(platform)
        episodes, clearances, wall_s = tabulate(task, recordings, folder, flown_as, adoption)
    row = summarise(name, task.name, trained_seed, platform, stacking, greedy, wall_s, episodes)
    row["paper"] = paper
    climbs = any(action.kind == "level" for action in task.actions)
    notes = platform_notes(platform, task.simulator.performance.types, climbs)
    notes += [] if cycles_note is None else [cycles_note]
    return Evaluation(row, episodes, clearances, failed, tuple(notes))


def _fly_here(
    task: TrafficTask,
    controller: Controller | AgentController,
    conditions: Conditions,
    on_scenario: Callable[[int], None],
) -> Generator[Recording, None, None]:
    seed, episodes, stacking = conditions.seed, conditions.episodes, conditions.stacking
    if isinstance(controller, AgentController):
        recordings = fly_with_agent(task, controller, seed, episodes, stacking)
    else:
        recordings = prepare(task, controller.decide, stacking)(controller.weights, seed, episodes)
    done = 0
    for block in recordings:
        done += len(block.number)
        yield block
        del block  # free the memory before the next block is flown
        on_scenario(done)


def _fly_on_platform(
    task: TrafficTask,
    controller: Callable[[], Controller | AgentController],
    conditions: Conditions,
    failed: dict[int, str],
    on_scenario: Callable[[int], None],
) -> Generator[Recording, None, None]:
    """Fly on another platform, whose own files are written to a temporary folder."""
    job = PlatformRollout(
        task,
        controller,
        conditions.stacking,
        conditions.seed,
        partial(open_platform, conditions.platform),
    )
    _check_sent(job)
    limit_s = conditions.time_limit_s
    with scratch_folder("skystack-") as scratch:
        yield from fly_on_platform(job, conditions.episodes, scratch, failed, limit_s, on_scenario)


def _check_sent(job: PlatformRollout) -> None:
    """Raise InputError for a controller that cannot be sent to other processes."""
    try:
        pickle.dumps(job)
    except Exception as error:  # pickling can raise any exception
        raise InputError(
            f"the policy cannot be sent to other processes, as other platforms require: {error}"
        ) from error
