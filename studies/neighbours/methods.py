"""What a decision is in each method, and what it can express."""

from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple

import msgspec

from skystack.learning.experiment import Experiment, load_experiment
from skystack.learning.network import Head
from skystack.tasks.contract import Task
from skystack.tasks.navigation import NavigationTask
from skystack.tasks.registry import build_task
from skystack.tasks.stacked_steps import StackedSteps
from studies.neighbours.absolute import with_absolute_actions, with_large_changes
from studies.neighbours.decisions import (
    Decisions,
    MakeDecisions,
    MakeHead,
    conditional_head,
    held,
    independent_head,
    options,
    repeated,
    repetitions,
)

MOST = 10
"""The maximum number of cycles of a decision."""
TYPICAL = 5
"""The assumed mean length of a decision of 1 to `MOST` cycles."""
SIZES = range(10, 91, 10)
"""The sizes of large changes and of options: degrees or flight levels."""


class Way(NamedTuple):
    """How a trained policy is evaluated."""

    stacked: bool = False
    greedy: bool = True
    look_ahead: bool = False
    """Whether a clearance is checked before it is issued, see `flights.worse`."""

    @property
    def name(self) -> str:
        """For tables and files."""
        action = "greedy" if self.greedy else "sampled"
        checked = ", checked" if self.look_ahead else ""
        return f"{'stacked' if self.stacked else 'unstacked'}, {action}{checked}"


ALONE = (Way(),)
STACKING = (
    Way(),
    Way(greedy=False),
    Way(stacked=True),
    Way(stacked=True, greedy=False),
    Way(stacked=True, look_ahead=True),
)


def _same(task: NavigationTask) -> Task:
    return task


class Method(NamedTuple):
    """A method: the decisions that a policy learns to take."""

    decision: str
    """What one decision is."""
    expresses: str
    """The clearances that one decision can express."""
    task: Callable[[NavigationTask], Task] = _same
    """Makes the task whose actions form the decisions."""
    decisions: MakeDecisions | None = None
    """Decisions of several cycles. None: each action of the task is a decision."""
    head: MakeHead | None = None
    lengths: int | None = None
    """The number of lengths per action, if the greedy decision is the best action, then its best
    length. None: the greedy decision is the most probable one."""
    cycles: int = 1
    """The typical length of a decision. Updates are scaled by it, so that all methods collect about
    the same number of cycles."""
    learner: Literal["ppo", "temporl"] = "ppo"
    ways: tuple[Way, ...] = ALONE


METHODS = {
    "small changes": Method(
        "one change of 10, or none, every cycle",
        "changes of 10; a larger one is a burst, which stacking compiles into one clearance",
        ways=STACKING,
    ),
    "frozen time": Method(
        "one change of 10 while time is frozen, or the end of the stack",
        "the same, but training also covers the states that stacking visits",
        task=StackedSteps,
        ways=STACKING,
    ),
    **{
        f"frame skip {cycles}": Method(
            f"the same action in {cycles} consecutive cycles",
            f"changes of {10 * cycles}; larger multiples take several decisions",
            decisions=partial(repeated, cycles=cycles),
            cycles=cycles,
        )
        for cycles in (2, 5, 10)
    },
    **{
        f"every {cycles} cycles": Method(
            f"one change of 10, or none, every {cycles} cycles",
            f"changes of 10, at most one in {6 * cycles} s",
            decisions=partial(held, cycles=cycles),
            cycles=cycles,
        )
        for cycles in (2, 5, 10)
    },
    "FiGAR": Method(
        f"the same action in 1 to {MOST} cycles; the length is independent of the action",
        f"changes of 10 to {10 * MOST}, and waiting",
        decisions=partial(repetitions, most=MOST),
        head=partial(independent_head, most=MOST),
        lengths=MOST,
        cycles=TYPICAL,
    ),
    "TempoRL (PPO)": Method(
        f"the same action in 1 to {MOST} cycles; the length depends on the action",
        f"changes of 10 to {10 * MOST}, and waiting",
        decisions=partial(repetitions, most=MOST),
        head=partial(conditional_head, most=MOST),
        lengths=MOST,
        cycles=TYPICAL,
    ),
    "TempoRL (DQN)": Method(
        "the same, learned with Q-networks for the action and for the length",
        f"changes of 10 to {10 * MOST}, and waiting",
        decisions=partial(repetitions, most=MOST),
        learner="temporl",
    ),
    "options": Method(
        f"the same change in 1 to {len(SIZES)} cycles, or one cycle without any",
        f"changes of 10 to {SIZES[-1]}; waiting is decided every cycle",
        decisions=partial(options, most=len(SIZES)),
        cycles=2,
    ),
    "large changes": Method(
        f"one change of 10 to {SIZES[-1]}, or none, every cycle",
        f"changes of 10 to {SIZES[-1]} at once (the paper's 37 actions)",
        task=partial(with_large_changes, sizes=SIZES),
    ),
    "absolute 10": Method(
        "one of 36 headings, one level, or none, every cycle",
        "any heading or level that is a multiple of 10",
        task=partial(with_absolute_actions, step_deg=10),
    ),
    "absolute 5": Method(
        "one of 72 headings, or none, every cycle",
        "any heading that is a multiple of 5",
        task=partial(with_absolute_actions, step_deg=5),
    ),
}


class Problem(NamedTuple):
    """A task, its rewards and the budget for training on it."""

    experiment: str
    cycles: int
    """The budget: simulated cycles, summed over all environments."""
    methods: tuple[str, ...] = tuple(METHODS)


PROBLEMS = {
    "lateral": Problem("lateral", 4_000_000),
    "vertical": Problem(
        "vertical", 1_000_000, tuple(name for name in METHODS if name != "absolute 5")
    ),
    "avoidance": Problem("avoidance-tuned", 8_000_000),
}
VERSION = 3
"""Increased when earlier results are no longer valid."""
SAMPLES, ENVIRONMENTS, MINIBATCH = 8192, 64, 256
SETTINGS = (
    "task.reward.count_criterion=false",
    "ppo.learning_rate=3e-4",
    "ppo.final_learning_rate=1.0",
    "ppo.gae_lambda=0.95",
    f"ppo.environments={ENVIRONMENTS}",
    "ppo.epochs=10",
)
"""The same for all methods. The learning rate is the default of Stable-Baselines3, so that it
favours no method. It is constant, because the number of updates in the budget is not known in
advance. There is no criterion for the number of instructions, because in some methods one clearance
takes several."""


def experiment_of(problem: Problem, method: Method) -> Experiment:
    """The experiment of a problem, with the settings of the study.

    Every update has about `SAMPLES` cycles and the same number of gradient steps, whatever the
    length of decisions. The number of cycles is nominal: it assumes the method's typical length.
    """
    changes = [
        f"ppo.steps={SAMPLES // ENVIRONMENTS // method.cycles}",
        f"ppo.minibatch={MINIBATCH // method.cycles}",
    ]
    if load_experiment(problem.experiment).pretraining is not None:
        changes.append("pretraining.reward.count_criterion=false")
    return load_experiment(problem.experiment, [*SETTINGS, *changes])


class Build(NamedTuple):
    """A method applied to the task of an experiment."""

    trained: Task
    """The task whose step is one decision."""
    flown: Task
    """The task used in evaluation: without the frozen-time steps, which are only for training."""
    head: Head | None
    lengths: int | None
    """As in `Method`."""
    loss_below_nm: float
    """A smaller separation is a loss."""


def build(method: Method, experiment: Experiment, pretraining: bool = False) -> Build:
    """The tasks of a method for an experiment, with the pre-training rewards if `pretraining`."""
    settings, first = experiment.task, experiment.pretraining
    if pretraining and first is not None:
        settings = msgspec.structs.replace(settings, reward=first.reward)
    task = build_task(settings)
    if not isinstance(task, NavigationTask):
        raise TypeError(f"{task.name} is not a navigation task")
    trained = method.task(task)
    actions = len(trained.action_names)
    if method.decisions is not None:
        trained = Decisions(trained, method.decisions(actions), experiment.ppo.gamma)
    head = None if method.head is None else method.head(actions)
    flown = trained.task if isinstance(trained, StackedSteps) else trained
    return Build(trained, flown, head, method.lengths, task.sector.loss_below_nm)
