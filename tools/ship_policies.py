"""Ship policies in the package: copy them from a run, measure them, write their model cards.

    python -m tools.ship_policies RUN [NAME ...]           of a run of `skystack reproduce`
    python -m tools.ship_policies --measure [NAME ...]     what ships, measured again
    python -m tools.ship_policies --cards [NAME ...]       the cards from what was measured

Without a NAME: all experiments of the run, or all policies that ship. Of a run it is always the
policy of the lowest seed, never the best.
"""

import argparse
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

import skystack
from skystack.errors import InputError, unknown_name
from skystack.evaluation.evaluate import Conditions, evaluate
from skystack.evaluation.summary import aggregate
from skystack.io.files import atomic_write, make_folder
from skystack.learning.experiment import experiment_from, load_experiment
from skystack.learning.policy import Policy, load_policy
from skystack.policies import measured, shipped
from skystack.policies.measured import Measured
from skystack.reporting import model_card
from skystack.reproduction.run import machine

JUDGED = (
    Conditions(episodes=1000, stacking=False),
    Conditions(episodes=1000, stacking=True),
    Conditions(seed=1, episodes=10_000, stacking=True),
)
"""The last are other scenarios: settings of our own were chosen on those of evaluation seed 0."""
POLICY_FILES = ("policy.safetensors", "policy.json")


def trained_policies(run: Path) -> dict[str, Path]:
    """The folder of the lowest seed of every experiment that was trained in a run."""
    seeds: dict[str, dict[int, Path]] = {}
    for folder in run.glob("train/*/"):
        if found := re.fullmatch(r"(.+)-s(\d+)", folder.name):
            seeds.setdefault(found[1], {})[int(found[2])] = folder
    if not seeds:
        raise InputError(f"{run}: holds no train/<experiment>-s<seed>; no run of reproduce")
    return {name: folders[min(folders)] for name, folders in sorted(seeds.items())}


def load_trained(folder: Path, name: str) -> Policy:
    """A policy of a run. Raises InputError unless it is what the experiment of the name says."""
    policy = load_policy(folder)
    described = policy.description
    trained, stated = experiment_from(described.config, str(folder)), load_experiment(name)
    settings = ("name", "task", "ppo", "pretraining")
    other = [each for each in settings if getattr(trained, each) != getattr(stated, each)]
    if other:
        raise InputError(
            f"{folder}: trained with other settings than experiment {name} "
            f"({', '.join(other)}); was it --quick?"
        )
    if folder.name != f"{described.experiment}-s{described.seed}":
        raise InputError(f"{folder}: holds {described.experiment}, seed {described.seed}")
    return policy


def measure(name: str, policy: Policy, revision: str | None, console: Console) -> Measured:
    """Judge a policy that ships under a name, as `skystack evaluate` does."""
    rows = []
    for conditions in JUDGED:
        command = f"skystack evaluate {name} --episodes {conditions.episodes}"
        command += f" --seed {conditions.seed} --{'' if conditions.stacking else 'no-'}stacking"
        console.print(command, highlight=False, soft_wrap=True)
        judged = evaluate(policy, conditions, None)
        row = aggregate([judged.row], [judged.episodes])
        rows.append({"command": f"{command} --json"} | row)
    return Measured(
        format=measured.FORMAT,
        sha256=policy.description.sha256,
        machine=machine(),
        version=skystack.__version__,
        git_revision=revision,
        rows=rows,
    )


def measured_before(name: str) -> Measured:
    """What is written beside a shipped policy. Raises InputError where it is not of that policy."""
    folder = shipped.SHIPPED / name
    found = measured.read_measured(folder)
    if found is None or found.sha256 != load_policy(folder).description.sha256:
        raise InputError(f"{folder / measured.FILE}: not there or of another policy; use --measure")
    return found


def write(name: str, policy: Policy, found: Measured, source: Path | None = None) -> None:
    """Write what was measured and the card, and the policy too where it comes from elsewhere."""
    contents = {file: (source / file).read_bytes() for file in POLICY_FILES if source}
    contents[measured.FILE] = measured.to_json(found)
    contents[model_card.FILE] = model_card.card(name, policy, found).encode()
    folder = make_folder(shipped.SHIPPED / name)
    for file, data in contents.items():
        atomic_write(folder / file, data)


def revision() -> str | None:
    """Of the code that measures, with `-dirty` where it was changed."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        found = subprocess.run(
            command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip()


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("words", nargs="*", metavar="[RUN] [NAME ...]")
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--measure", action="store_true", help="measure what ships; no RUN")
    how.add_argument("--cards", action="store_true", help="write only the cards; no RUN")
    options = parser.parse_args(arguments)
    if not (options.measure or options.cards or options.words):
        raise InputError("RUN is missing (or --measure, or --cards)")
    return options


def _chosen(names: Sequence[str], allowed: Sequence[str], where: str) -> list[str]:
    for name in names:
        if name not in allowed:
            raise unknown_name(f"policy of {where}", name, allowed)
    return list(names or allowed)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 done, 2 wrong input."""
    console = Console(stderr=True)
    try:
        options = _options(arguments)
        if options.measure or options.cards:
            names = _chosen(options.words, shipped.shipped_policies(), "the package")
            sources: dict[str, Path] = {}
        else:
            run, *wanted = options.words
            sources = trained_policies(Path(run))
            names = _chosen(wanted, list(sources), run)
        now = revision()
        for name in names:
            source = sources.get(name)
            policy = load_trained(source, name) if source else shipped.find_policy(name)
            found = measured_before(name) if options.cards else measure(name, policy, now, console)
            write(name, policy, found, source)
    except InputError as error:
        console.print(f"error: {error}", soft_wrap=True, markup=False, highlight=False)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
