"""The plan of a reproduction: experiments by family, seeds, scenarios, other simulators."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from skystack.errors import unknown_name
from skystack.learning.experiment import Experiment, experiment_names, load_experiment
from skystack.learning.run import CHECKPOINT_EVERY_S
from skystack.platforms.registry import OWN, check_platform
from skystack.tasks.contract import TrafficTask
from skystack.tasks.registry import build_task, tasks

FIRST_LOOK = ("lateral", "lateral-best")
"""The experiments that are reproduced by default: the paper's, and the best of ours."""
QUICK_STEPS = 500_000
QUICK_EPISODES = 200
PLATFORM_EPISODES = 100
"""The number of scenarios on other simulators, as in the paper."""
OWN_FOLDERS = ("evaluation", "evaluation/*", "figures")
"""The subfolders that a reproduction writes to, except trainings, which have their own locks."""


@dataclass(frozen=True)
class Plan:
    """What to reproduce, and the folder to write to."""

    experiments: tuple[Experiment, ...]
    seeds: int
    episodes: int
    out: Path
    quick: bool
    command: str
    platforms: tuple[str, ...] = ()
    """Other simulators, in which the policies of the first seed are flown."""
    with_shipped: bool = False
    """Also evaluate the policy that is shipped for each experiment."""
    with_sampled: bool = False
    """Also evaluate each policy with sampled actions, as in training."""
    checkpoint_every_s: float = CHECKPOINT_EVERY_S

    def training(self, name: str) -> Path:
        """The folder of a training."""
        return self.out / "train" / name

    @property
    def evaluation(self) -> Path:
        """The folder of all evaluations."""
        return self.out / "evaluation"


def families_of_experiments() -> dict[str, list[str]]:
    """The experiments with scenarios, by family, which is their task.

    Sector control has hours of traffic instead, and is not part of the paper.
    """
    families: dict[str, list[str]] = {name: [] for name in tasks()}
    for name in experiment_names():
        settings = load_experiment(name).task
        if isinstance(build_task(settings), TrafficTask):
            families[settings.name].append(name)
    return {family: names for family, names in families.items() if names}


def make_plan(
    families: Sequence[str],
    seeds: int,
    episodes: int,
    out: Path,
    quick: bool,
    command: str,
    platforms: Sequence[str] = (),
) -> Plan:
    """Plan the experiments of some families, also with sampled actions unless it is quick.

    Without a family, plan `FIRST_LOOK` beside the shipped policies. Raises InputError for unknown
    families or platforms.
    """
    others = _other_platforms(platforms)
    known = families_of_experiments()
    names: list[str] = [] if families else list(FIRST_LOOK)
    for family in families:
        if family != "all" and family not in known:
            raise unknown_name("family", family, [*known, "all"])
        chosen = list(known) if family == "all" else [family]
        names += [name for key in chosen for name in known[key] if name not in names]
    experiments = tuple(map(load_experiment, names))
    return Plan(
        tuple(map(_quick, experiments)) if quick else experiments,
        seeds,
        episodes,
        out,
        quick,
        command,
        others,
        with_shipped=not families,
        with_sampled=bool(families) and not quick,
    )


def describe_plan(plan: Plan) -> tuple[str, ...]:
    """What a plan will do, in a few lines."""
    steps = ", ".join(f"{each.name} ({each.ppo.total_steps:,} steps)" for each in plan.experiments)
    seeds = f" with {plan.seeds} seeds each" if plan.seeds > 1 else ""
    ways = ", with the most probable and with sampled actions" if plan.with_sampled else ""
    return (
        f"plan: train {steps}{seeds};",
        f"fly {plan.episodes:,} held-out scenarios with each policy, unstacked and stacked{ways};",
        f"write a report to {plan.out}",
    )


def _other_platforms(platforms: Sequence[str]) -> tuple[str, ...]:
    for each in platforms:
        check_platform(each)
    return tuple(dict.fromkeys(name for name in platforms if name != OWN))


def _quick(experiment: Experiment) -> Experiment:
    """The experiment with fewer steps; pretraining is shortened in proportion."""
    total_steps, pretraining = experiment.ppo.total_steps, experiment.pretraining
    steps = min(total_steps, QUICK_STEPS)
    if pretraining is not None:
        shortened = max(pretraining.steps * steps // total_steps, 1)
        pretraining = msgspec.structs.replace(pretraining, steps=shortened)
    ppo = msgspec.structs.replace(experiment.ppo, total_steps=steps)
    return msgspec.structs.replace(experiment, ppo=ppo, pretraining=pretraining)
