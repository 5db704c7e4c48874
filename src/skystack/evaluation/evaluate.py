"""Judge one controller on held-out scenarios: fly, write the tables, reduce them to a row."""

import pickle
from collections.abc import Callable, Generator
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa

from skystack.agents.agent import Agent, agent_of
from skystack.airspace.sectors import AnySector, named_or_read
from skystack.errors import MOST_NUMBER, InputError, checked_whole
from skystack.evaluation.hosted import HostedController, fly_hosted
from skystack.evaluation.platform_rollout import PlatformRollout, fly_on_platform
from skystack.evaluation.rollout import (
    NO_OP_CONTROLLER,
    Controller,
    Recording,
    network_controller,
    prepare,
)
from skystack.evaluation.summary import RowValues, summarise
from skystack.evaluation.tabulate import tabulate
from skystack.io.files import AnyPath, make_folder, scratch_folder
from skystack.io.locks import no_empty_folders
from skystack.io.names import as_name, check_name
from skystack.learning.experiment import (
    Experiment,
    experiment_from,
    experiment_names,
    load_experiment,
)
from skystack.learning.policy import Policy, PolicyDescription
from skystack.platforms.processes import TIME_LIMIT_S, checked_time_limit
from skystack.platforms.registry import (
    OWN,
    adoption_of,
    check_platform,
    flown_type,
    open_platform,
    platform_notes,
)
from skystack.policies.facts import Facts
from skystack.tasks.build import build_task, check_cycles
from skystack.tasks.navigation import NavigationTask
from skystack.tasks.settings import MOST_CYCLES

NO_OP_NAME = "do-nothing"
AnyExperiment = AnyPath | Experiment
"""A name, a file (.toml) or the experiment itself."""


class Conditions(NamedTuple):
    """How a controller is judged."""

    seed: int = 0
    """Of the scenarios."""
    episodes: int = 1000
    stacking: bool = True
    greedy: bool = True
    platform: str = OWN
    time_limit_s: float = TIME_LIMIT_S
    """For one scenario on another platform."""
    sector: AnySector | None = None
    """Another sector than the one that it was trained in."""
    cycles: int | None = None
    """The most cycles of a scenario; those of its training where none is given."""


class Evaluation(NamedTuple):
    """A row and the scenarios behind it."""

    row: RowValues
    episodes: pa.Table
    clearances: pa.Table
    """Texts are dictionaries: what repeats in them takes no memory."""
    failed: dict[int, str]
    """Scenarios that the platform did not finish, and why; they are in neither."""
    notes: tuple[str, ...] = ()
    """What the user should know: what a platform flew in another way than the task asks for, and
    routes that take longer than a scenario."""


def policy_task(
    policy: Policy, sector: AnySector | None = None, cycles: int | None = None
) -> NavigationTask:
    """The task that a policy was trained for, as it is flown; in another sector if one is given,
    and for another number of cycles.

    Raises InputError when this version's task is another one than the policy's.
    """
    described = policy.description
    where = f"policy {described.experiment}-s{described.seed}"
    experiment: Experiment = experiment_from(described.config, where)
    task = _task(experiment, sector, cycles)
    _check_trained_for(task, described, where)
    return task


def agent_task(
    agent: Agent,
    experiment: AnyExperiment | None,
    sector: AnySector | None = None,
    cycles: int | None = None,
) -> NavigationTask:
    """The task that an agent is judged on: its experiment's, in another sector if one is given.

    An export of our own policies names its experiment; all others need one, by name, file (.toml)
    or itself. Raises InputError where it is missing, or the agent does not observe what its task
    shows or has other actions.
    """
    facts = agent.facts
    if experiment is None and facts is not None and facts.experiment in experiment_names():
        experiment = facts.experiment
    if experiment is None:
        known = f": its {facts.experiment!r} does not ship" if facts else ""
        raise InputError(
            f"{agent.name} does not say which experiment it is for{known} (allowed: --experiment "
            "NAME or FILE.toml; in Python experiment=...)"
        )
    if not isinstance(experiment, Experiment):
        experiment = load_experiment(experiment)
    task = _task(experiment, sector, cycles)
    if facts is not None:
        _check_trained_for(task, facts, agent.name)
    seen, actions = len(task.observation_names), len(task.action_names)
    if agent.observations not in (None, seen) or agent.actions not in (None, actions):
        has = f"{agent.observations or '?'} observed values and {agent.actions or '?'} actions"
        its = f"{experiment.name}: {seen}, {actions}"
        raise InputError(f"{agent.name} has {has} (allowed for {its})")
    return task


def _task(experiment: Experiment, sector: AnySector | None, cycles: int | None) -> NavigationTask:
    settings = experiment.task
    if sector is not None:
        settings = msgspec.structs.replace(settings, sector=named_or_read(sector))
    if cycles is not None:
        settings = msgspec.structs.replace(settings, cycles=cycles)
    return build_task(settings)


def _check_trained_for(
    task: NavigationTask, described: PolicyDescription | Facts, where: str
) -> None:
    if (described.task_name, described.task_version) != (task.name, task.version):
        raise InputError(
            f"{where} was trained for task {described.task_name} version "
            f"{described.task_version} (allowed: {task.name} version {task.version}); train it anew"
        )
    if described.observation != task.observation_names or described.actions != task.action_names:
        raise InputError(f"{where}: its observation or actions are not those of its task")


_USUAL = Conditions()


def _checked(conditions: Conditions) -> Conditions:
    """The conditions as plain values. Raises InputError for invalid ones."""
    cycles = conditions.cycles
    return conditions._replace(
        seed=checked_whole("seed", conditions.seed, 0, MOST_NUMBER),
        episodes=checked_whole("episodes", conditions.episodes, 1, MOST_NUMBER),
        cycles=None if cycles is None else checked_whole("cycles", cycles, 1, MOST_CYCLES),
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
    conditions: Conditions = _USUAL,
    out: AnyPath | None = None,
    on_scenario: Callable[[int], None] = lambda done: None,
    *,
    experiment: AnyExperiment | None = None,
    name: str | None = None,
) -> Evaluation:
    """Fly a policy on the scenarios of an evaluation seed; `out` is the folder for evaluations.

    `policy` is one of `find_policy` or `find_agent`; a function from an observation, float32
    `[observation]`, to the number of an action; a `Batched` function of many observations; or a
    model of Stable-Baselines3. All but the first must decide by the observation alone: they are
    asked for one scenario after the other, on other platforms in other processes. They need the
    `experiment` that they are for, its name, its file (.toml) or itself, unless they say which.

    `name` is that of the row and of the folder. `on_scenario` hears how many scenarios are done.
    Raises InputError for invalid conditions, a platform that is not there, an experiment that
    does not fit and a policy that fails or answers with what is no action; PlatformError when no
    scenario is finished.
    """
    check_platform(conditions.platform)
    conditions = _checked(conditions)
    out = None if out is None else Path(out)
    if isinstance(policy, Policy):
        return _evaluate_own(policy, conditions, out, on_scenario, experiment, name)
    agent = agent_of(policy, name)
    task = agent_task(agent, experiment, conditions.sector, conditions.cycles)
    if not conditions.greedy and not agent.logits:
        raise InputError(
            f"{agent.name} has no probabilities to sample from (allowed: its greedy action)"
        )
    controller = partial(HostedController, agent, conditions.greedy)
    called, seed = as_name(name or agent.name), agent.facts.seed if agent.facts else 0
    return _evaluate(called, seed, task, controller, conditions, out, on_scenario)


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
            f"{described.experiment} carries its own experiment (allowed: --experiment with "
            "policies of other libraries)"
        )
    controller = partial(network_controller, policy.actor, policy.normaliser, conditions.greedy)
    called = as_name(name) if name else described.experiment
    return _evaluate(called, described.seed, task, controller, conditions, out, on_scenario)


def evaluate_no_op(experiment: Experiment, conditions: Conditions, out: Path | None) -> Evaluation:
    """The same scenarios with no instructions at all."""
    task = build_task(experiment.task)
    plain = conditions._replace(stacking=False)
    return _evaluate(NO_OP_NAME, 0, task, lambda: NO_OP_CONTROLLER, plain, out, lambda done: None)


def evaluation_folder(
    out: Path, experiment: str, seed: int, stacking: bool, platform: str = OWN
) -> Path:
    """Where the tables of an evaluation lie. Raises InputError for an invalid folder name."""
    check_name("the name of the experiment", experiment)
    kind = "stacked" if stacking else "plain"
    return out / f"{experiment}-s{seed}-{platform}-{kind}"


def _evaluate(
    name: str,
    trained_seed: int,
    task: NavigationTask,
    controller: Callable[[], Controller | HostedController],
    conditions: Conditions,
    out: Path | None,
    on_scenario: Callable[[int], None],
) -> Evaluation:
    """Fly, make the tables, write them where wanted, and reduce them to the row."""
    beyond = check_cycles(task)
    platform, stacking = conditions.platform, conditions.stacking
    folder = None if out is None else evaluation_folder(out, name, trained_seed, stacking, platform)
    failed = dict[int, str]()
    if platform == OWN:
        flying = _fly_here(task, controller(), conditions, on_scenario)
    else:
        flying = _fly_on_platform(task, controller, conditions, out, failed, on_scenario)
    with closing(flying):
        flown_as, adoption = partial(flown_type, platform), adoption_of(platform)
        episodes, clearances, wall_s = tabulate(task, flying, folder, flown_as, adoption)
    row = summarise(name, trained_seed, platform, stacking, conditions.greedy, wall_s, episodes)
    climbs = task.actions.kind == "level"
    notes = platform_notes(platform, task.simulator.performance.types, climbs)
    notes += [] if beyond is None else [beyond]
    return Evaluation(row, episodes, clearances, failed, tuple(notes))


def _fly_here(
    task: NavigationTask,
    controller: Controller | HostedController,
    conditions: Conditions,
    on_scenario: Callable[[int], None],
) -> Generator[Recording, None, None]:
    seed, episodes, stacking = conditions.seed, conditions.episodes, conditions.stacking
    if isinstance(controller, HostedController):
        flying = fly_hosted(task, controller, seed, episodes, stacking)
    else:
        flying = prepare(task, controller.decide, stacking)(controller.weights, seed, episodes)
    done = 0
    for block in flying:
        done += len(block.number)
        yield block
        del block  # before the next one is flown
        on_scenario(done)


def _fly_on_platform(
    task: NavigationTask,
    controller: Callable[[], Controller | HostedController],
    conditions: Conditions,
    out: Path | None,
    failed: dict[int, str],
    on_scenario: Callable[[int], None],
) -> Generator[Recording, None, None]:
    """Fly on another platform; its own files lie where the system keeps what is thrown away."""
    job = PlatformRollout(
        task,
        controller,
        conditions.stacking,
        conditions.seed,
        partial(open_platform, conditions.platform),
    )
    _check_sent(job)
    limit_s = conditions.time_limit_s
    with ExitStack() as stack:
        if out is not None:
            stack.enter_context(no_empty_folders(out))
            make_folder(out)  # refused before anything is flown, which takes long
        work = stack.enter_context(scratch_folder("skystack-"))
        yield from fly_on_platform(job, conditions.episodes, work, failed, limit_s, on_scenario)


def _check_sent(job: PlatformRollout) -> None:
    """Raise InputError for a controller that cannot be sent to other processes."""
    try:
        pickle.dumps(job)
    except Exception as error:  # objects raise what they like when they are pickled
        raise InputError(
            f"the policy cannot be sent to other processes, as other platforms need: {error}"
        ) from error
