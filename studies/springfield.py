"""Springfield: controllers on the fixed scenarios of BluebirdDT's Springfield.

    python -m studies.springfield [AGENT ...] [--platform bluebird] [--out DIR]

Flies every scenario under every agent for long enough that all flights can leave, and prints a
Markdown table. Finished evaluations in DIR are reused, so the command can be interrupted and
repeated. Needs the extra `[bluebird]`.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from skystack.agents.sector_agents import SECTOR_AGENTS
from skystack.errors import InputError
from skystack.evaluation.controllers import find_controller
from skystack.evaluation.fixed_traffic import SPRINGFIELD
from skystack.evaluation.hour_row import HourRow
from skystack.evaluation.traffic_conditions import BLUEBIRD, TrafficConditions
from skystack.io.files import make_folder
from skystack.platforms.bluebird_springfield import scenario_names
from skystack.platforms.registry import PLATFORMS
from skystack.reporting.hour_table import decimals
from skystack.reporting.table import Table
from skystack.reporting.tables import percent
from skystack.tasks.sector_control import SectorControl
from studies.capacity import row_of
from studies.parallel import run_pieces

CYCLES = 1200
"""Two hours. The slowest flights need most of it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 success, 2 invalid input."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.springfield", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("agents", nargs="*", metavar="AGENT")
    parser.add_argument("--platform", choices=PLATFORMS[:2], default=BLUEBIRD)
    parser.add_argument("--out", type=Path, default=Path("runs/springfield"))
    options = parser.parse_args(arguments)
    agents, names = options.agents or [*SECTOR_AGENTS, SectorControl.name], scenario_names()
    try:
        pieces = []
        for agent in agents:
            for name in names:
                conditions = TrafficConditions(
                    f"{SPRINGFIELD}:{name}", cycles=CYCLES, platform=options.platform
                )
                if name == names[0]:
                    row_name = find_controller(agent, conditions).name
                pieces.append((agent, row_name, conditions, make_folder(options.out)))
        rows = run_pieces(row_of, pieces, "evaluations")
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(table(rows, agents).as_markdown())
    return 0


def table(rows: Sequence[HourRow], agents: Sequence[str]) -> Table:
    """One row per agent: its results on all scenarios together. `rows` are agent by agent."""
    count = len(rows) // len(agents)
    groups = [rows[begin : begin + count] for begin in range(0, len(rows), count)]
    headings = (
        "controller",
        "scenarios",
        "without a failure (lax score)",
        "flights",
        "correct exits",
        "excursions",
        "losses of separation",
        "transmissions per flight",
        "extra distance",
    )
    return Table(headings, tuple(_cells(group) for group in groups))


def _cells(rows: Sequence[HourRow]) -> tuple[str, ...]:
    """Rates are means over scenarios, weighted by their flights."""

    def mean(name: str) -> float | None:
        values = [(getattr(row, name), row.flights) for row in rows]
        known = [(value, flights) for value, flights in values if value is not None]
        total = sum(flights for _, flights in known)
        return sum(value * flights for value, flights in known) / total if total else None

    return (
        rows[0].agent,
        str(len(rows)),
        str(sum(row.lax_s_mean == row.length_s for row in rows)),
        str(sum(row.flights for row in rows)),
        percent(mean("correct_exit_rate")),
        percent(mean("excursion_rate")),
        str(sum(row.losses_of_separation for row in rows)),
        decimals(mean("transmissions_per_flight"), 2),
        percent(mean("extra_miles_rate")),
    )


if __name__ == "__main__":
    sys.exit(main())
