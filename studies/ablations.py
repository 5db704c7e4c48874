"""Ablations of skystack's own experiments: revert one choice, train, and evaluate as usual.

    python -m studies.ablations EXPERIMENT [--seed N] [--out DIR]

EXPERIMENT is one of those below. Prints a Markdown table, row by row: clearances, success and
losses of separation on 1,000 held-out scenarios, stacked. Finished work in DIR is reused; DIR may
be a run folder of `skystack reproduce`, which has the unchanged experiment.
"""

import argparse
import sys
from pathlib import Path

import msgspec

from skystack.compilation.programs import compile_for_cores
from skystack.errors import InputError, unknown_name
from skystack.learning.experiment import Experiment, load_experiment
from skystack.reproduction.jobs import Way, evaluate_or_load, train_or_load
from skystack.reproduction.plan import Plan

EPISODES = 1000
PAPER_STATE = 'task.features=["theta_f","theta_sf","d_c","delta_t"]'
PAPER_PAIR = 'task.pair_features=["theta","d"]'
PAPER_LEARNER = ("ppo.learning_rate=1e-4", "ppo.final_learning_rate=1.0")
DAMPED = ("task.reward.burst=0.0", "task.reward.damping=0.25")
NOT_STACKED = "task.timing=cycle"

ABLATIONS: dict[str, dict[str, tuple[str, ...]]] = {
    "lateral-best": {
        "nothing": (),
        "time advances during a stack": (NOT_STACKED,),
        "damping instead of a cost for bursts": DAMPED,
        "the paper's state": (PAPER_STATE,),
        "the paper's learning rate": PAPER_LEARNER,
        "no first phase with cheap bursts": ("pretraining.steps=1",),
        "reward for the centreline, none for excursions": (
            "task.reward.excursion=0.0",
            "task.reward.centreline=1.0",
        ),
    },
    "avoidance-tuned": {
        "nothing": (),
        "the paper's cost of predicted conflicts": ("task.reward.safety=2.0",),
        "the paper's state": (PAPER_PAIR,),
        "the paper's learning rate": PAPER_LEARNER,
    },
    "avoidance-best": {
        "nothing": (),
        "the paper's observation of the other aircraft": (PAPER_PAIR,),
        "time advances during a stack": (NOT_STACKED,),
        "a cost of predicted conflicts": ("task.reward.safety=0.5",),
        "conflicts charged only inside 5.5 NM": ("task.reward.conflict_nm=5.5",),
    },
}
"""For each experiment, the description of each change, and the changed settings."""


def ablate(name: str, seed: int, out: Path) -> None:
    """Train and evaluate every variant."""
    if name not in ABLATIONS:
        raise unknown_name("experiment", name, list(ABLATIONS))
    sys.stdout.write(
        "| changed | clearances | success | losses of separation |\n|---|---:|---:|---:|\n"
    )
    for number, (description, changes) in enumerate(ABLATIONS[name].items()):
        variant = load_experiment(name, changes)
        variant = msgspec.structs.replace(variant, name=f"{name}-{number}" if changes else name)
        sys.stdout.write(f"| {description} | {_results(variant, seed, out)} |\n")
        sys.stdout.flush()


def _results(variant: Experiment, seed: int, out: Path) -> str:
    plan = Plan((variant,), 1, EPISODES, out, quick=False, command="")
    policy, _, _ = train_or_load(plan, variant, seed, lambda progress: None)
    row = evaluate_or_load(plan, policy, Way(stacking=True, greedy=True))[0].row
    clearances = f"{row['clearances_mean']:.2f}"
    return f"{clearances} | {row['success_rate']:.3f} | {row['loss_of_separation_count']}"


def main() -> int:
    """Returns the exit code: 0 success, 2 invalid input."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("experiment", metavar="EXPERIMENT")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/ablations"))
    options = parser.parse_args()
    compile_for_cores(1)
    try:
        ablate(options.experiment, options.seed, options.out)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
