"""Capacity: controllers of a sector against the number of flights per hour.

    python -m studies.capacity [AGENT ...] [--traffic 30 60 ...] [--hours 20] [--uncertainty]
        [--out DIR]

Flies hours of traffic (seed 1) under every agent, by default the built-in agents and the shipped
policy, and prints a Markdown table for each agent. Finished rows in DIR are reused, so the command
can be interrupted and repeated.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from skystack.agents.sector_agents import SECTOR_AGENTS
from skystack.errors import InputError, checked_integer
from skystack.evaluation.traffic import TrafficConditions, evaluate_traffic, find_controller
from skystack.io.files import atomic_write, make_folder
from skystack.reporting.hour_table import losses
from skystack.reporting.table import Table
from skystack.reporting.tables import percent
from skystack.tasks.sector_control import SectorControl
from studies.parallel import run_pieces

TRAFFIC = ("30", "60", "120", "200", "category")
SEED = 1


def row_of(agent: str, conditions: TrafficConditions, out: Path) -> dict[str, Any]:
    """The row of an agent on some traffic, from its file if it has been flown before."""
    uncertain = "-uncertain" if conditions.uncertainty else ""
    path = out / f"{Path(agent).name}-{conditions.traffic}-{conditions.hours}{uncertain}.json"
    if path.exists():
        known: dict[str, Any] = json.loads(path.read_text())
        return known
    row = evaluate_traffic(agent, conditions)
    atomic_write(path, (json.dumps(row, indent=1) + "\n").encode())
    return row


def table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """One line per traffic, for the rows of one agent."""
    header = (
        "traffic",
        "flights",
        "losses of separation (at birth)",
        "correct exits",
        "excursions",
        "transmissions per flight",
        "worst minute",
        "fail-safe",
        "extra distance",
        "lax score, s",
        "strict score, s",
        "decision, ms",
    )
    lines = [
        (
            str(row["traffic"]),
            f"{row['flights']:,}",
            losses(row),
            percent(row["correct_exit_rate"]),
            percent(row["excursion_rate"]),
            f"{row['transmissions_per_flight']:.2f}",
            str(row["transmissions_worst_minute"]),
            percent(row["fail_safe_rate"]),
            percent(row["extra_miles_rate"]),
            f"{row['lax_s_mean']:,.0f}",
            f"{row['strict_s_mean']:,.0f}",
            f"{row['decision_ms_median']:.1f}",
        )
        for row in rows
    ]
    return Table(header, tuple(lines))


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 success, 2 invalid input."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.capacity", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("agents", nargs="*", metavar="AGENT")
    parser.add_argument("--traffic", nargs="+", default=list(TRAFFIC), metavar="TRAFFIC")
    parser.add_argument("--hours", type=int, default=20)
    parser.add_argument("--uncertainty", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("runs/capacity"))
    options = parser.parse_args(arguments)
    agents = options.agents or [*SECTOR_AGENTS, SectorControl.name]
    try:
        checked_integer("--hours", options.hours, 1)
        pieces = []
        for agent in agents:
            for traffic in options.traffic:
                conditions = TrafficConditions(
                    traffic, options.hours, SEED, uncertainty=options.uncertainty
                )
                find_controller(agent, conditions)  # raises for mistakes before anything is flown
                pieces.append((agent, conditions, make_folder(options.out)))
        rows = run_pieces(row_of, pieces, "evaluations")
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    for agent in agents:
        mine = [row for piece, row in zip(pieces, rows, strict=True) if piece[0] == agent]
        sys.stdout.write(f"\n### {agent}\n\n{table(mine).as_markdown()}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
