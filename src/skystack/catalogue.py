"""What there is: experiments, tasks, sectors, and the policies that come with the package."""

from importlib.resources import files
from pathlib import Path
from typing import Any

from rich.table import Table

from skystack.errors import unknown_name
from skystack.learning.experiment import experiment_names, load_experiment
from skystack.learning.policy import Policy, load_policy
from skystack.simulator.performance import PERFORMANCE
from skystack.tasks.build import SECTORS, TASKS

SHIPPED = Path(str(files("skystack").joinpath("policies")))


def shipped_policies() -> list[str]:
    """Names of the policies in the package."""
    return sorted(path.parent.name for path in SHIPPED.glob("*/policy.json"))


def find_policy(name: str) -> Policy:
    """A shipped policy by name, or the one in a run folder.

    Raises InputError when there is neither, or the policy cannot be used.
    """
    if name in shipped_policies():
        return load_policy(SHIPPED / name)
    folder = Path(name)
    if folder.name == "policy.json":
        folder = folder.parent
    if not (folder / "policy.json").exists():
        raise unknown_name(
            "policy (no shipped one, no folder with a policy.json)", name, shipped_policies()
        )
    return load_policy(folder)


def catalogue() -> dict[str, Any]:
    """Everything that has a name, with a line on each."""
    experiments = [load_experiment(name) for name in experiment_names()]
    policies = [load_policy(SHIPPED / name).description for name in shipped_policies()]
    return {
        "experiments": {each.name: each.description for each in experiments},
        "tasks": list(TASKS),
        "sectors": list(SECTORS),
        "performance": list(PERFORMANCE),
        "policies": {
            each.experiment: f"task {each.task_name} version {each.task_version}, seed {each.seed}"
            for each in policies
        },
    }


def catalogue_table(found: dict[str, Any]) -> list[Table]:
    """The catalogue for a terminal."""
    tables = []
    for title, entries in found.items():
        table = Table(title=title, title_justify="left", show_header=False, box=None, min_width=60)
        for name in entries:
            table.add_row(f"  {name}", entries[name] if isinstance(entries, dict) else "")
        tables.append(table)
    return tables
