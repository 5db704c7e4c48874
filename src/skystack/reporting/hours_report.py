"""The report on hours of traffic: capacity and survival of controllers of a sector."""

from collections.abc import Sequence
from pathlib import Path

import skystack
from skystack.agents.transmission import PER_CYCLE
from skystack.errors import InputError, printable
from skystack.evaluation.hour_row import HourRow, folders_of_hours, read_row
from skystack.evaluation.scenario_traffic import is_scenario
from skystack.io.files import atomic_write
from skystack.platforms.registry import OWN
from skystack.reporting.hour_figures import capacity, survival
from skystack.reporting.hour_table import (
    decimals,
    failed_in_words,
    hours_in_words,
    losses,
    ranges,
)
from skystack.reporting.page import picture_of, render
from skystack.reporting.style import as_svg, house_style
from skystack.reporting.table import Table
from skystack.reporting.tables import percent
from skystack.simulator.arrival_flows import HOUR_CYCLES

REPORT = "hours.html"


def read_hours(folders: Sequence[Path]) -> list[HourRow]:
    """The rows in folders that `evaluate --traffic --out` wrote, by agent and traffic.

    Raises InputError for a folder without rows, or with a damaged one.
    """
    found_in = dict[Path, None]()
    for folder in folders:
        found = folders_of_hours(folder)
        if not found:
            raise InputError(
                f"{folder}: contains no hours of traffic (allowed: folders that evaluate "
                "--traffic --out or flight-school wrote)"
            )
        found_in |= dict.fromkeys(each.resolve() for each in found)
    rows = sorted(map(read_row, found_in), key=_order)
    sectors = sorted({printable(row.sector) for row in rows})
    if len(sectors) > 1:
        raise InputError(
            f"the hours are of different sectors: {', '.join(sectors)} "
            "(allowed: folders with hours of one sector)"
        )
    return rows


def _order(row: HourRow) -> tuple[str, float, str, int]:
    rate = row.flights_per_hour
    return label(row), float("inf") if rate is None else rate, row.traffic, row.seed


def controller(row: HourRow) -> str:
    """The agent, and what differs from the defaults."""
    parts = [row.agent]
    if row.safety_net is False:
        parts.append("no safety net")
    if row.per_cycle not in (None, PER_CYCLE):
        parts.append(f"{row.per_cycle} per cycle")
    if row.uncertainty:
        parts.append("uncertainty")
    if row.cycles < HOUR_CYCLES and not is_scenario(row.traffic):
        parts.append(f"{row.cycles} cycles")
    return printable(", ".join(parts))


def label(row: HourRow) -> str:
    """The controller and, if it is not ours, the simulator."""
    where = "" if row.platform == OWN else f", in {printable(row.platform)}"
    return controller(row) + where


def hours_table(rows: Sequence[HourRow]) -> Table:
    """One line per row."""
    header = (
        "controller",
        "traffic",
        "hours",
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
    return Table(header, tuple(_line(row) for row in rows))


def _line(row: HourRow) -> tuple[str, ...]:
    return (
        label(row),
        row.traffic,
        hours_in_words(row.hours) + failed_in_words(len(row.failed_seeds)),
        f"{row.flights:,}",
        losses(row.losses_of_separation, row.losses_at_birth),
        percent(row.correct_exit_rate),
        percent(row.excursion_rate),
        decimals(row.transmissions_per_flight, 2),
        str(row.transmissions_worst_minute),
        percent(row.fail_safe_rate),
        percent(row.extra_miles_rate),
        f"{row.lax_s_mean:,.0f}",
        f"{row.strict_s_mean:,.0f}",
        f"{row.decision_ms_median:.1f}",
    )


def write_hours_report(rows: Sequence[HourRow], output: Path) -> None:
    """Write the page. Raises InputError if it cannot be written."""
    seeds = sorted({seed for row in rows for seed in row.seeds})
    with house_style():
        curves = capacity([(label(row), row) for row in rows])
        survivals = survival([(controller(row), row) for row in rows])
        page = render(
            "hours.html.jinja",
            version=skystack.__version__,
            capacity=curves and picture_of(as_svg(curves), "Capacity: scores against traffic"),
            survival=picture_of(as_svg(survivals), "Hours without a failure against time"),
            table_of_rows=hours_table(rows),
            seeds=ranges(seeds),
            several=len(seeds) > 1,
        )
    atomic_write(output, page)
