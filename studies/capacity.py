"""Capacity: controllers of a sector against the number of flights per hour.

    python -m studies.capacity [AGENT ...] [--traffic 30 60 ...] [--hours 20] [--uncertainty]
        [--out DIR]

Flies hours of traffic (seed 1) under every agent, by default the built-in agents and the shipped
policy, prints a Markdown table, and writes a page with capacity and survival curves. Finished
evaluations in DIR are reused, so the command can be interrupted and repeated.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from skystack.agents.sector_agents import SECTOR_AGENTS
from skystack.errors import InputError, checked_integer, exists
from skystack.evaluation.controllers import find_controller
from skystack.evaluation.hour_row import ROW_FILE, HourRow, read_row
from skystack.evaluation.traffic import evaluate_traffic, hours_folder
from skystack.evaluation.traffic_conditions import TrafficConditions, traffic_name
from skystack.io.files import make_folder
from skystack.reporting.hours_report import REPORT, hours_table, write_hours_report
from skystack.tasks.sector_control import SectorControl
from studies.parallel import run_pieces

TRAFFIC = ("30", "60", "120", "200", "category")
SEED = 1


def row_of(agent: str, name: str, conditions: TrafficConditions, out: Path) -> HourRow:
    """The row of an agent on some traffic, from its folder if it has been flown before.

    `name` is the agent's name in the row.
    """
    folder = hours_folder(out, name, conditions)
    if exists(folder / ROW_FILE):
        row = read_row(folder)
        if (len(row.lax_s_by_hour), row.cycles) == (conditions.hours, conditions.cycles):
            return row
    evaluate_traffic(agent, conditions, out)
    return read_row(folder)


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
                    traffic_name(traffic), options.hours, SEED, uncertainty=options.uncertainty
                )
                # Raises for mistakes before anything is flown.
                name = find_controller(agent, conditions).name
                pieces.append((agent, name, conditions, make_folder(options.out)))
        rows = run_pieces(row_of, pieces, "evaluations")
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    write_hours_report(rows, options.out / REPORT)
    sys.stdout.write(hours_table(rows).as_markdown())
    return 0


if __name__ == "__main__":
    sys.exit(main())
