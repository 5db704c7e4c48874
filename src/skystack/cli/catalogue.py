"""The output of the verb `list`: everything that has a name, and the shipped policies."""

from typing import Any

from rich.table import Table
from rich.text import Text

from skystack.airspace.sectors import sector_names
from skystack.evaluation.paper import paper_row
from skystack.learning.experiment import experiment_names, load_experiment
from skystack.learning.policy import load_policy
from skystack.policies import shipped
from skystack.policies.measured import read_measured
from skystack.reporting.tables import NOTHING, mean_and_std, percent
from skystack.simulator.performance import PERFORMANCE
from skystack.tasks.features import FEATURES
from skystack.tasks.metrics import METRICS
from skystack.tasks.pairs import PAIR_FEATURES
from skystack.tasks.registry import tasks
from skystack.tasks.rewards import REWARDS


def catalogue() -> dict[str, Any]:
    """Everything that has a name, with descriptions where there are any."""
    experiments = [load_experiment(name) for name in experiment_names()]
    return {
        "experiments": {each.name: each.description for each in experiments},
        "tasks": {name: kind.description for name, kind in tasks().items()},
        "sectors": sector_names(),
        "performance": list(PERFORMANCE),
        "features": {name: each.meaning for name, each in FEATURES.items()},
        "pair features": {name: each.meaning for name, each in PAIR_FEATURES.items()},
        "rewards": {name: each.description for name, each in REWARDS.items()},
        "metrics": {name: each.description for name, each in METRICS.items()},
        "policies": {name: _policy(name) for name in shipped.shipped_policies()},
    }


def _policy(name: str) -> dict[str, Any]:
    """A shipped policy: its task, its measured row with stacking, and the paper's result."""
    described = load_policy(shipped.SHIPPED / name).description
    measured = read_measured(shipped.SHIPPED / name)
    if measured is not None and measured.sha256 != described.sha256:
        measured = None  # measured with another policy
    paper = (
        found | {"stacking": stacking}
        for stacking in (True, False)
        if (found := paper_row(described.experiment, stacking))
    )
    return {
        "task": described.task_name,
        "task_version": described.task_version,
        "seed": described.seed,
        "stacked": None if measured is None else measured.stacked,
        "paper": next(paper, None),
    }


def catalogue_table(found: dict[str, Any]) -> list[Table]:
    """The catalogue as tables for a terminal."""
    tables = []
    for title, entries in found.items():
        if title == "policies":
            continue
        table = Table(title=title, title_justify="left", show_header=False, box=None, min_width=60)
        for name in entries:
            table.add_row(f"  {name}", entries[name] if isinstance(entries, dict) else "")
        tables.append(table)
    return [*tables, _policies_table(found["policies"])]


def _policies_table(policies: dict[str, Any]) -> Table:
    table = Table(title="policies (one seed each), stacked", title_justify="left", box=None)
    table.add_column("", no_wrap=True)
    for name in ("clearances", "success", "losses of\nseparation", "clearances\nin the paper"):
        table.add_column(Text(name), justify="right", no_wrap=True)
    for name, policy in policies.items():
        row, paper = policy["stacked"], policy["paper"]
        measured = [NOTHING] * 3
        if row is not None:
            measured = [
                mean_and_std(row["clearances_mean"], row["clearances_std"]),
                percent(row["success_rate"]),
                f"{row['loss_of_separation_count']} of {row['episodes']}",
            ]
        reported = NOTHING
        if paper is not None:
            suffix = "" if paper["stacking"] else " unstacked"
            reported = mean_and_std(paper["clearances_mean"], paper["clearances_std"]) + suffix
        table.add_row(f"  {name}", *measured, reported)
    return table
