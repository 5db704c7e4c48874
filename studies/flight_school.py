"""Flight School: every controller on every kind of traffic, in our simulator and in others.

    python -m studies.flight_school [NAME ...] [--seeds 100] [--others 20] [--out DIR]
    python -m studies.flight_school --read [--out DIR]

Flies an hour per seed, from seed 1 on: `--seeds` of them in skystack, `--others` in BluebirdDT and,
for `category` traffic, in BlueSky. A case is a controller on one kind of traffic in one simulator.
NAME is one of these: with `search notebook`, only the cases that match both are flown and shown.

The results of each case are stored as a line of `docs/results/flight-school.jsonl` (`--results
FILE`). A case with stored results for the same number of seeds is not flown again, even if the code
has changed: to fly it again, delete its line. Finished seeds in DIR are reused if the code is the
same, so the command can be interrupted and repeated.

Prints the stored results as Markdown tables, compares the scores in skystack and BluebirdDT by
the Mann-Whitney test, and draws the survival curves of `docs/flight-school.md` into DIR; with
`--read`, nothing is flown. Failed seeds are reported and left out; the same command flies them
again. Needs the extras `[bluebird]` and `[bluesky]`.
"""

import argparse
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from scipy.stats import mannwhitneyu

from skystack.agents.sector_agents import BLUESKY_AGENTS, SECTOR_AGENTS
from skystack.errors import InputError, check_known, checked_integer
from skystack.evaluation.flight_school import fly_flight_school
from skystack.evaluation.hour_row import HourRow
from skystack.evaluation.traffic_conditions import BLUEBIRD, BLUESKY, TrafficConditions
from skystack.io.files import make_folder
from skystack.platforms.registry import OWN
from skystack.reporting.flight_school_table import comparison
from skystack.reporting.hour_figures import survival
from skystack.reporting.hours_report import controller
from skystack.reporting.style import house_style
from skystack.reporting.table import Table
from skystack.reporting.tables import NOTHING
from skystack.simulator.arrival_flows import FLIGHT_SCHOOL
from skystack.tasks.sector_control import SectorControl
from studies.hour_results import (
    RESULTS,
    Case,
    Result,
    case_of,
    read_results,
    result_in,
    write_results,
)
from studies.parallel import INTERRUPTED, TO_RESUME

FIRST_SEED = 1
FIGURE = "flight-school.png"


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


def named(names: Sequence[str]) -> list[Case]:
    """The cases that match all names. Raises InputError for an unknown name, or if none match."""
    check_known("name", names, {name for case in plan() for name in case})
    found = [case for case in plan() if set(names) <= set(case)]
    if not found:
        raise InputError(
            f"no case matches {', '.join(names)} (allowed: at most one controller, one kind of "
            "traffic and one simulator; BlueSky flies category only, and mvp flies in BlueSky only)"
        )
    return found


def fly(case: Case, seeds: int, out: Path) -> tuple[Result, list[str]]:
    """Fly the seeds that are not finished.

    Returns the results and a line for each seed that failed. Raises InputError as
    `fly_flight_school` does.
    """
    conditions = TrafficConditions(case.traffic, platform=case.platform)
    numbers = range(FIRST_SEED, FIRST_SEED + seeds)
    flown = fly_flight_school(case.agent, conditions, numbers, out)
    today = datetime.now(UTC).date().isoformat()
    return result_in(flown.folder, today), flown.failures


def read_cases(path: Path) -> dict[Case, Result]:
    """The results in a file by case. Raises InputError as `read_results` does."""
    return {case_of(each.hour_row): each for each in read_results(path)}


def fly_all(cases: Sequence[Case], options: argparse.Namespace) -> bool:
    """Fly the cases without results, and store the results of each case when it is finished.

    Returns whether all seeds were finished.
    """
    finished = True
    for case in cases:
        stored = read_cases(options.results)
        seeds = options.seeds if case.platform == OWN else options.others
        if case in stored and len(stored[case].hour_row.seeds) == seeds:
            continue
        result, failed = fly(case, seeds, options.out)
        # Read again: another run may have stored results in the meantime.
        stored = read_cases(options.results) | {case: result}
        planned = {each: stored[each] for each in plan() if each in stored}
        write_results(options.results, list((planned | stored).values()))
        sys.stderr.write(f"{' '.join(case)}: lax score {stored[case].row['lax_s_mean']:.0f} s\n")
        sys.stderr.writelines(f"{' '.join(case)}: {line}\n" for line in failed)
        finished &= not failed
    return finished


def agreement(rows: Sequence[HourRow]) -> Table:
    """The lax scores of the controllers that flew the same traffic in skystack and BluebirdDT.

    The two fly different hours. p is that of the two-sided Mann-Whitney test: scores are not
    normally distributed, because many are those of whole hours.
    """
    header = ("traffic: controller", "skystack, s", "BluebirdDT, s", "difference", "p")
    by_case = {case_of(row): row for row in rows}
    lines = []
    for case in plan():
        own, other = by_case.get(case), by_case.get(case._replace(platform=BLUEBIRD))
        if case.platform != OWN or own is None or other is None:
            continue
        scores = own.lax_s_by_hour, other.lax_s_by_hour
        all_equal = len({*scores[0], *scores[1]}) == 1
        p = NOTHING if all_equal else f"{mannwhitneyu(*scores).pvalue:.2f}"
        means = own.lax_s_mean, other.lax_s_mean
        difference = f"{100.0 * (means[0] / means[1] - 1.0):+.1f} %"
        shown = (f"{each:,.0f}" for each in means)
        lines.append((f"{case.traffic}: {case.agent}", *shown, difference, p))
    return Table(header, tuple(lines))


def show(rows: Sequence[HourRow], out: Path) -> None:
    """Print the tables, and draw the survival curves."""
    make_folder(out)
    with house_style():
        survival([(controller(row), row) for row in rows]).savefig(out / FIGURE, dpi=120)
    for platform in (OWN, BLUEBIRD, BLUESKY):
        for traffic in FLIGHT_SCHOOL:
            found = [row for row in rows if (row.platform, row.traffic) == (platform, traffic)]
            if found:
                sys.stdout.write(f"\n### `{traffic}` in {platform}\n\n")
                sys.stdout.write(comparison(found).as_markdown())
    if (agreeing := agreement(rows)).rows:
        sys.stdout.write(f"\n### skystack and bluebird\n\n{agreeing.as_markdown()}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 success, 1 if seeds failed, 2 invalid input, 130 interrupted."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.flight_school", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--others", type=int, default=20)
    parser.add_argument("--read", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("runs/flight-school"))
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    try:
        for name in ("seeds", "others"):
            checked_integer(f"--{name}", getattr(options, name), 1)
        cases = named(options.names)
        finished = options.read or fly_all(cases, options)
        rows = [each.hour_row for each in read_results(options.results)]
        rows = [row for row in rows if case_of(row) in cases]
        if not rows:
            raise InputError(f"{options.results}: contains no results for these cases")
        show(rows, options.out)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write(TO_RESUME)
        return INTERRUPTED
    return 0 if finished else 1


if __name__ == "__main__":
    sys.exit(main())
