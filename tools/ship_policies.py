"""Ship policies in the package: copy them from a run, measure them, write their model cards.

    python -m tools.ship_policies RUN [NAME ...]           ship policies of `skystack reproduce`
    python -m tools.ship_policies --measure [NAME ...]     measure shipped policies again
    python -m tools.ship_policies --cards [NAME ...]       write the cards again

Without a NAME: all experiments of the run, or all shipped policies. From a run, the policy of the
lowest seed is shipped, never the best one.
"""

import argparse
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

import skystack
from skystack.cli.arguments import Parser
from skystack.errors import InputError, unknown_name
from skystack.evaluation.evaluate import Conditions, evaluate
from skystack.evaluation.summary import aggregate
from skystack.evaluation.traffic import evaluate_traffic
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.io.files import atomic_write, make_folder
from skystack.learning.experiment import experiment_from, load_experiment
from skystack.learning.policy import Policy, load_policy
from skystack.policies import measured, shipped
from skystack.policies.measured import Measured
from skystack.reporting import model_card
from skystack.reproduction.run import machine
from skystack.tasks.sector_control import SectorControl
from studies.parallel import run_pieces

CONDITIONS = (
    Conditions(episodes=1000, stacking=False),
    Conditions(episodes=1000, stacking=True),
    Conditions(seed=1, episodes=10_000, stacking=True),
)
"""The last one has other scenarios, because our settings were chosen on those of seed 0."""
TRAFFIC = (
    *(TrafficConditions(rate, hours=20, seed=1) for rate in ("120", "60", "30", "200")),
    TrafficConditions("category", hours=20, seed=1),
    TrafficConditions("120", hours=20, seed=1, safety_net=False),
)
"""The conditions for policies of sector control."""
POLICY_FILES = ("policy.safetensors", "policy.json")


def trained_policies(run: Path) -> dict[str, Path]:
    """The folder of the lowest seed of every experiment trained in a run."""
    seeds: dict[str, dict[int, Path]] = {}
    for folder in run.glob("train/*/"):
        if found := re.fullmatch(r"(.+)-s(\d+)", folder.name):
            seeds.setdefault(found[1], {})[int(found[2])] = folder
    if not seeds:
        raise InputError(f"{run}: has no train/<experiment>-s<seed> (allowed: a run of reproduce)")
    return {name: folders[min(folders)] for name, folders in sorted(seeds.items())}


def load_trained(folder: Path, name: str) -> Policy:
    """A policy of a run. Raises InputError unless its settings are those of the experiment."""
    policy = load_policy(folder)
    description = policy.description
    trained, expected = experiment_from(description.config, str(folder)), load_experiment(name)
    settings = ("name", "task", "ppo", "pretraining")
    different = [each for each in settings if getattr(trained, each) != getattr(expected, each)]
    if different:
        raise InputError(
            f"{folder}: was trained with other settings than experiment {name} "
            f"({', '.join(different)}), perhaps with --quick"
        )
    if folder.name != f"{description.experiment}-s{description.seed}":
        raise InputError(f"{folder}: contains {description.experiment}, seed {description.seed}")
    return policy


def measure(name: str, policy: Policy, revision: str | None, console: Console) -> Measured:
    """Evaluate a policy that ships under a name, as `skystack evaluate` does."""
    hours = policy.description.task_name == SectorControl.name
    rows = _hours(name, policy, console) if hours else _scenarios(name, policy, console)
    return Measured(
        format=measured.FORMAT,
        sha256=policy.description.sha256,
        machine=machine(),
        version=skystack.__version__,
        git_revision=revision,
        rows=rows,
    )


def _scenarios(name: str, policy: Policy, console: Console) -> list[dict[str, Any]]:
    rows = []
    for conditions in CONDITIONS:
        command = f"skystack evaluate {name} --episodes {conditions.episodes}"
        command += f" --seed {conditions.seed} --{'' if conditions.stacking else 'no-'}stacking"
        console.print(command, highlight=False, soft_wrap=True)
        evaluated = evaluate(policy, conditions, None)
        row = aggregate([evaluated.row], [evaluated.episodes])
        rows.append({"command": f"{command} --json"} | row)
    return rows


def _hours(name: str, policy: Policy, console: Console) -> list[dict[str, Any]]:
    """The rows of sector control, one process per core."""
    jobs = []
    for conditions in TRAFFIC:
        command = f"skystack evaluate {name} --traffic {conditions.traffic}"
        command += f" --episodes {conditions.hours} --seed {conditions.seed}"
        command = " ".join([command, *conditions.options])
        console.print(command, highlight=False, soft_wrap=True)
        jobs.append((f"{command} --json", policy, conditions))
    return run_pieces(_row, jobs, "evaluations")


def _row(command: str, policy: Policy, conditions: TrafficConditions) -> dict[str, Any]:
    return {"command": command} | evaluate_traffic(policy, conditions)


def measured_before(name: str) -> Measured:
    """The stored measurements of a shipped policy. Raises InputError for another policy's."""
    folder = shipped.SHIPPED / name
    found = measured.read_measured(folder)
    if found is None or found.sha256 != load_policy(folder).description.sha256:
        raise InputError(
            f"{folder / measured.FILE}: missing, or measured with another policy (use --measure)"
        )
    return found


def write(name: str, policy: Policy, found: Measured, source: Path | None = None) -> None:
    """Write the measurements and the card, and the policy if it comes from a run."""
    contents = {file: (source / file).read_bytes() for file in POLICY_FILES if source}
    contents[measured.FILE] = measured.to_json(found)
    contents[model_card.FILE] = model_card.card(name, policy, found).encode()
    folder = make_folder(shipped.SHIPPED / name)
    for file, data in contents.items():
        atomic_write(folder / file, data)


def revision() -> str | None:
    """The git revision of the code, with `-dirty` if there are uncommitted changes."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        found = subprocess.run(
            command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip()


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = Parser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("words", nargs="*", metavar="[RUN] [NAME ...]")
    how = parser.add_mutually_exclusive_group()
    how.add_argument(
        "--measure", action="store_true", help="measure shipped policies again; no RUN"
    )
    how.add_argument("--cards", action="store_true", help="write the cards again; no RUN")
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
    """The command line; returns the exit code: 0 success, 2 invalid input."""
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
        policies = [
            load_trained(sources[name], name) if sources else shipped.find_policy(name)
            for name in names
        ]
        for name, policy in zip(names, policies, strict=True):
            source = sources.get(name)
            found = measured_before(name) if options.cards else measure(name, policy, now, console)
            write(name, policy, found, source)
    except InputError as error:
        console.print(f"error: {error}", soft_wrap=True, markup=False, highlight=False)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
