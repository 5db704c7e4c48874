"""What each choice of our own experiments is worth: train without it, judge as the row is judged.

    python -m studies.ablations EXPERIMENT [--seed N] [--out DIR]

EXPERIMENT is one of those below. Prints a Markdown table as it grows: clearances, success and
losses of separation on 1,000 held-out scenarios, stacked. What is in DIR is not trained again; DIR
may be the run of a `skystack reproduce`, which has the unchanged one.
"""

import argparse
import sys
from pathlib import Path

import msgspec

from skystack.compilation.programs import compile_for_one_core
from skystack.errors import InputError, unknown_name
from skystack.learning.experiment import Experiment, load_experiment
from skystack.reproduction.jobs import flown_once, trained_once
from skystack.reproduction.plan import Plan

EPISODES = 1000
PAPER_STATE = 'task.features=["theta_f","theta_sf","d_c","delta_t"]'
PAPER_PAIR = 'task.pair_features=["theta","d"]'
PAPER_LEARNER = ("ppo.learning_rate=1e-4", "ppo.final_learning_rate=1.0")
DAMPED = ("task.reward.burst=0.0", "task.reward.damping=0.25")
NOT_STACKED = "task.timing=cycle"

ABLATIONS: dict[str, dict[str, tuple[str, ...]]] = {
    "lateral-best": {
        "as it is": (),
        "time goes on in a stack": (NOT_STACKED,),
        "damping in place of a price for bursts": DAMPED,
        "the paper's state": (PAPER_STATE,),
        "the paper's learning rate": PAPER_LEARNER,
        "no first part with cheap bursts": ("pretraining.steps=1",),
        "paid for the centreline, not for excursions": (
            "task.reward.stray=0.0",
            "task.reward.centreline=1.0",
        ),
    },
    "avoidance-tuned": {
        "as it is": (),
        "the paper's price of predicted conflicts": ("task.reward.safety=2.0",),
        "the paper's state": (PAPER_PAIR,),
        "the paper's learning rate": PAPER_LEARNER,
    },
    "avoidance-best": {
        "as it is": (),
        "the paper's view of the other aircraft": (PAPER_PAIR,),
        "time goes on in a stack": (NOT_STACKED,),
        "no price of predicted conflicts": ("task.reward.safety=0.0",),
        "conflicts cost inside 5.5 NM": ("task.reward.conflict_nm=5.5",),
    },
}
"""What is changed, and how."""


def ablate(name: str, seed: int, out: Path) -> None:
    """Train and judge every variant."""
    if name not in ABLATIONS:
        raise unknown_name("experiment", name, list(ABLATIONS))
    sys.stdout.write(
        "| changed | clearances | success | losses of separation |\n|---|---:|---:|---:|\n"
    )
    for number, (words, changes) in enumerate(ABLATIONS[name].items()):
        variant = load_experiment(name, changes)
        variant = msgspec.structs.replace(variant, name=f"{name}-{number}" if changes else name)
        sys.stdout.write(f"| {words} | {_judged(variant, seed, out)} |\n")
        sys.stdout.flush()


def _judged(variant: Experiment, seed: int, out: Path) -> str:
    plan = Plan((variant,), 1, EPISODES, out, quick=False, command="")
    policy, _, _ = trained_once(plan, variant, seed, lambda progress: None)
    row = flown_once(plan, policy, stacking=True)[0].row
    clearances = f"{row['clearances_mean']:.2f}"
    return f"{clearances} | {row['success_rate']:.3f} | {row['loss_of_separation_count']}"


def main() -> int:
    """Returns the exit code: 0 done, 2 wrong input."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("experiment", metavar="EXPERIMENT")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/ablations"))
    options = parser.parse_args()
    compile_for_one_core()
    try:
        ablate(options.experiment, options.seed, options.out)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
