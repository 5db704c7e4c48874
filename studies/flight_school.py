"""Flight School: every controller on every kind of traffic, in our simulator and in others.

    python -m studies.flight_school [--seeds 100] [--others 20] [--out DIR]
    python -m studies.flight_school --read [--out DIR]

Flies an hour per seed, from seed 1 on: `--seeds` of them in skystack, `--others` in BluebirdDT and,
of `category` traffic, in BlueSky. Prints Markdown tables and draws the survival curves of
`docs/flight-school.md` into DIR. Finished seeds are reused, so the command can be interrupted and
repeated; with `--read`, nothing is flown: the tables show the results already in DIR. Failed seeds
are left out. Needs the extras `[bluebird]` and `[bluesky]`.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from skystack.agents.sector_agents import BLUESKY_AGENTS, SECTOR_AGENTS
from skystack.errors import InputError, checked_integer
from skystack.evaluation.flight_school import fly_flight_school
from skystack.evaluation.hour_row import HourRow
from skystack.evaluation.traffic_conditions import BLUEBIRD, BLUESKY, TrafficConditions
from skystack.platforms.registry import OWN
from skystack.reporting.flight_school_table import comparison
from skystack.reporting.hour_figures import survival
from skystack.reporting.hours_report import label, read_hours
from skystack.reporting.style import house_style
from skystack.simulator.arrival_flows import FLIGHT_SCHOOL
from skystack.tasks.sector_control import SectorControl

FIRST_SEED = 1
FIGURE = "flight-school.png"


class Case(NamedTuple):
    """A controller on some traffic in a simulator."""

    agent: str
    traffic: str
    platform: str


def plan() -> list[Case]:
    """All that is flown, the learned controller and the search first."""
    agents = [SectorControl.name, "search", *(each for each in SECTOR_AGENTS if each != "search")]
    flown = [
        Case(agent, traffic, platform)
        for platform in (OWN, BLUEBIRD)
        for traffic in FLIGHT_SCHOOL
        for agent in agents
    ]
    return flown + [Case(agent, "category", BLUESKY) for agent in (*agents, *BLUESKY_AGENTS)]


def fly(out: Path, seeds: int, others: int) -> None:
    """Fly everything that is not finished yet. Raises InputError as `fly_flight_school` does."""
    for each in plan():
        count = seeds if each.platform == OWN else others
        conditions = TrafficConditions(each.traffic, platform=each.platform)
        result = fly_flight_school(
            each.agent, conditions, range(FIRST_SEED, FIRST_SEED + count), out
        )
        sys.stderr.write(f"{each}: lax score {result.row['lax_s_mean']:.0f} s\n")


def draw(rows: Sequence[HourRow], path: Path) -> None:
    """Draw the survival curves."""
    with house_style():
        survival([(label(row), row) for row in rows]).savefig(path, dpi=120)


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 success, 2 invalid input."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.flight_school", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--others", type=int, default=20)
    parser.add_argument("--read", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("runs/flight-school"))
    options = parser.parse_args(arguments)
    try:
        for name in ("seeds", "others"):
            checked_integer(f"--{name}", getattr(options, name), 1)
        if not options.read:
            fly(options.out, options.seeds, options.others)
        rows = read_hours([options.out])
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    draw(rows, options.out / FIGURE)
    for platform in (OWN, BLUEBIRD, BLUESKY):
        for traffic in FLIGHT_SCHOOL:
            found = [row for row in rows if (row.platform, row.traffic) == (platform, traffic)]
            if found:
                sys.stdout.write(f"\n### `{traffic}` in {platform}\n\n")
                sys.stdout.write(comparison(found).as_markdown())
    return 0


if __name__ == "__main__":
    sys.exit(main())
