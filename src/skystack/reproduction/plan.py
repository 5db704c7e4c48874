"""What is to be reproduced: experiments by family, seeds, scenarios, other simulators."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from skystack.errors import unknown_name
from skystack.learning.experiment import Experiment, load_experiment
from skystack.learning.run import CHECKPOINT_EVERY_S
from skystack.platforms.registry import OWN, check_platform

FAMILIES = {
    "lateral": ("lateral-undamped", "lateral", "lateral-large", "lateral-tuned", "lateral-best"),
    "vertical": ("vertical",),
    "avoidance": ("avoidance", "avoidance-large", "avoidance-tuned", "avoidance-best"),
}
"""Experiments of each family."""

QUICK_STEPS = 500_000
QUICK_EPISODES = 200
PLATFORM_EPISODES = 100
"""As many scenarios as the paper's."""
OWN_FOLDERS = ("evaluation", "evaluation/*", "figures")
"""Where in its folder a reproduction writes beside its trainings, which look after themselves."""


@dataclass(frozen=True)
class Plan:
    """What is to be reproduced, and where it is written."""

    experiments: tuple[Experiment, ...]
    seeds: int
    episodes: int
    out: Path
    quick: bool
    command: str
    platforms: tuple[str, ...] = ()
    """Other simulators to fly the first seed's policies in."""
    checkpoint_every_s: float = CHECKPOINT_EVERY_S

    def training(self, name: str) -> Path:
        """The folder of a training."""
        return self.out / "train" / name

    @property
    def evaluation(self) -> Path:
        """The folder of all evaluations."""
        return self.out / "evaluation"


def plan_families(
    families: Sequence[str],
    seeds: int,
    episodes: int,
    out: Path,
    quick: bool,
    command: str,
    platforms: Sequence[str] = (),
) -> Plan:
    """The experiments of some families. Raises InputError for an unknown one or a platform."""
    for each in platforms:
        check_platform(each)
    names: list[str] = []
    for family in families:
        if family != "all" and family not in FAMILIES:
            raise unknown_name("family", family, [*FAMILIES, "all"])
        chosen = list(FAMILIES) if family == "all" else [family]
        names += [name for key in chosen for name in FAMILIES[key] if name not in names]
    experiments = tuple(load_experiment(name) for name in names)
    if quick:
        experiments = tuple(_quick(experiment) for experiment in experiments)
    elsewhere = tuple(dict.fromkeys(name for name in platforms if name != OWN))
    return Plan(experiments, seeds, episodes, out, quick, command, elsewhere)


def _quick(experiment: Experiment) -> Experiment:
    """The same experiment with fewer steps, its first phase shortened alike."""
    whole, before = experiment.ppo.total_steps, experiment.pretraining
    steps = min(whole, QUICK_STEPS)
    if before is not None:
        shorter = max(before.steps * steps // whole, 1)
        before = msgspec.structs.replace(before, steps=shorter)
    ppo = msgspec.structs.replace(experiment.ppo, total_steps=steps)
    return msgspec.structs.replace(experiment, ppo=ppo, pretraining=before)
