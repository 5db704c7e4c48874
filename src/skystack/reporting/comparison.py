"""Several runs beside each other on one page: curves, figures, and what was set differently."""

import json
from collections.abc import Sequence
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple

import msgspec

import skystack
from skystack.io.files import atomic_write
from skystack.reporting import tables
from skystack.reporting.learning_curves import overlaid_curves
from skystack.reporting.page import Picture, picture_of, render
from skystack.reporting.results import FAMILIES, Update
from skystack.reporting.style import as_svg, house_style
from skystack.reporting.tables import NOTHING, Table
from skystack.reporting.trainings import Learned, RowOf, Runs, differences

WIDEST = 40
"""Characters of a cell in the terminal; lists of observed values are longer."""


class ComparedFamily(NamedTuple):
    """What the page shows of one family: only within it can curves and rows be compared."""

    title: str
    curves: Picture | None
    trainings: Table
    rows: Table
    settings: Table


def write_comparison(runs: Runs, output: Path) -> None:
    """Write the page. Raises InputError when it cannot be written."""
    page = render(
        "comparison.html.jinja",
        version=skystack.__version__,
        sections=[_section(runs, family) for family in _families(runs)],
    )
    atomic_write(output, page)


def comparison_tables(runs: Runs) -> list[Table]:
    """For the terminal: trainings, rows where there are any, and settings that differ."""
    parts = [trainings_table(runs.trainings), rows_table(runs.rows)]
    parts += [_shortened(settings_table(_of(runs, family).trainings)) for family in _families(runs)]
    return [table for table in parts if table.rows]


def comparison_json(runs: Runs) -> dict[str, Any]:
    """The same for programs."""
    return {
        "train": [each.summary for each in runs.trainings],
        "rows": [{"run": each.run} | _plain(each) for each in runs.rows],
        "settings": {
            family: settings_that_differ(_of(runs, family).trainings) for family in _families(runs)
        },
    }


def trainings_table(trainings: Sequence[Learned]) -> Table:
    """One line a training; success and instructions are those at its end, while it explores."""
    header = ("run", "experiment", "seed", "steps", "time", "success", "instructions")
    lines = []
    for each in trainings:
        found = each.summary
        lines.append(
            (
                each.run,
                each.experiment,
                NOTHING if each.seed is None else str(each.seed),
                f"{found['steps']:,}",
                NOTHING if found["wall_s"] is None else tables.duration(found["wall_s"]),
                tables.percent(found["success"]),
                tables.decimal(found["instructions"]),
            )
        )
    return Table(header, tuple(lines))


def rows_table(rows: Sequence[RowOf]) -> Table:
    """The comparison with the paper, of all runs that were judged."""
    plain = tables.comparison([each.row for each in rows])
    first, *others = plain.header
    lines = [(line[0], each.run, *line[1:]) for each, line in zip(rows, plain.rows, strict=True)]
    return Table((first, "run", *others), tuple(lines))


def settings_that_differ(trainings: Sequence[Learned]) -> dict[str, dict[str, Any]]:
    """By key and curve; the seeds of a curve have the same settings."""
    return differences({each.curve: each.settings for each in trainings})


def settings_table(trainings: Sequence[Learned]) -> Table:
    """One line a setting, one column a curve."""
    found = settings_that_differ(trainings)
    names = dict.fromkeys(each.curve for each in trainings)
    lines = [(key, *(_shown(values[name]) for name in names)) for key, values in found.items()]
    return Table(("setting", *names), tuple(lines))


def _families(runs: Runs) -> list[str]:
    there = {each.family for each in runs.trainings} | {each.row.family for each in runs.rows}
    return [family for family in FAMILIES if family in there]


def _of(runs: Runs, family: str) -> Runs:
    return Runs(
        [each for each in runs.trainings if each.family == family],
        [each for each in runs.rows if each.row.family == family],
    )


def _section(runs: Runs, family: str) -> ComparedFamily:
    trainings, rows = _of(runs, family)
    return ComparedFamily(
        FAMILIES[family],
        _curves(trainings),
        trainings_table(trainings),
        rows_table(rows),
        settings_table(trainings),
    )


def _curves(trainings: Sequence[Learned]) -> Picture | None:
    curves: dict[str, list[list[Update]]] = {}
    for each in trainings:
        curves.setdefault(each.curve, []).append(each.updates)
    if not curves:
        return None
    with house_style():
        drawing = as_svg(overlaid_curves(curves))
    return picture_of(drawing, f"Learning curves of {', '.join(curves)}")


def _plain(each: RowOf) -> dict[str, Any]:
    found: dict[str, Any] = msgspec.to_builtins(each.row)
    return found


def _shown(value: Any) -> str:
    """As in TOML, names without quotes; a dash where the setting is absent."""
    if isinstance(value, list):
        return ", ".join(map(_shown, value))
    if value is None:
        return NOTHING
    return value if isinstance(value, str) else json.dumps(value)


def _shortened(table: Table) -> Table:
    rows = [tuple(shorten(cell, WIDEST, placeholder=" ...") for cell in row) for row in table.rows]
    return Table(table.header, tuple(rows))
