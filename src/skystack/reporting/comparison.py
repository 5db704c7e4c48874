"""A comparison of several runs: learning curves, results and the settings that differ."""

import json
from collections.abc import Sequence
from pathlib import Path
from textwrap import shorten
from typing import Any, NamedTuple

import msgspec

import skystack
from skystack.io.files import atomic_write
from skystack.reporting import tables
from skystack.reporting.families import family_order, family_title
from skystack.reporting.learning_curves import overlaid_curves
from skystack.reporting.page import Picture, picture_of, render
from skystack.reporting.results import Update
from skystack.reporting.style import as_svg, house_style
from skystack.reporting.table import Table
from skystack.reporting.tables import NOTHING
from skystack.reporting.trainings import RunRow, Runs, TrainingRun, differences

WIDEST = 40
"""The maximum length of a cell in the terminal; lists of features are longer."""


class ComparedFamily(NamedTuple):
    """The section on one family. Curves and rows are only comparable within a family."""

    title: str
    curves: Picture | None
    trainings: Table
    rows: Table
    settings: Table


def write_comparison(runs: Runs, output: Path) -> None:
    """Write the page. Raises InputError if it cannot be written."""
    page = render(
        "comparison.html.jinja",
        version=skystack.__version__,
        sections=[_section(runs, family) for family in _families(runs)],
    )
    atomic_write(output, page)


def comparison_tables(runs: Runs) -> list[Table]:
    """The tables for the terminal: training runs, rows if any, and settings that differ."""
    parts = [trainings_table(runs.trainings), rows_table(runs.rows)]
    parts += [
        _shortened(settings_table(_of_family(runs, family).trainings)) for family in _families(runs)
    ]
    return [table for table in parts if table.rows]


def comparison_json(runs: Runs) -> dict[str, Any]:
    """The comparison as a JSON object."""
    return {
        "train": [each.summary for each in runs.trainings],
        "rows": [{"run": each.run} | _row_object(each) for each in runs.rows],
        "settings": {
            family: settings_that_differ(_of_family(runs, family).trainings)
            for family in _families(runs)
        },
    }


def trainings_table(trainings: Sequence[TrainingRun]) -> Table:
    """One line per training run; success and instructions are final values, with exploration."""
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


def rows_table(rows: Sequence[RunRow]) -> Table:
    """The comparison with the paper for all runs that were evaluated."""
    plain = tables.comparison([each.row for each in rows])
    first, *others = plain.header
    lines = [(line[0], each.run, *line[1:]) for each, line in zip(rows, plain.rows, strict=True)]
    return Table((first, "run", *others), tuple(lines))


def settings_that_differ(trainings: Sequence[TrainingRun]) -> dict[str, dict[str, Any]]:
    """Settings by key and curve. The seeds of a curve have the same settings."""
    return differences({each.curve: each.settings for each in trainings})


def settings_table(trainings: Sequence[TrainingRun]) -> Table:
    """One line per setting, one column per curve."""
    found = settings_that_differ(trainings)
    names = dict.fromkeys(each.curve for each in trainings)
    lines = [
        (key, *(_setting_text(values[name]) for name in names)) for key, values in found.items()
    ]
    return Table(("setting", *names), tuple(lines))


def _families(runs: Runs) -> list[str]:
    trained = {each.family for each in runs.trainings}
    return family_order(trained | {each.row.family for each in runs.rows})


def _of_family(runs: Runs, family: str) -> Runs:
    return Runs(
        [each for each in runs.trainings if each.family == family],
        [each for each in runs.rows if each.row.family == family],
    )


def _section(runs: Runs, family: str) -> ComparedFamily:
    trainings, rows = _of_family(runs, family)
    return ComparedFamily(
        family_title(family),
        _curves(trainings),
        trainings_table(trainings),
        rows_table(rows),
        settings_table(trainings),
    )


def _curves(trainings: Sequence[TrainingRun]) -> Picture | None:
    curves: dict[str, list[list[Update]]] = {}
    for each in trainings:
        curves.setdefault(each.curve, []).append(each.updates)
    if not curves:
        return None
    with house_style():
        drawing = as_svg(overlaid_curves(curves))
    return picture_of(drawing, f"Learning curves of {', '.join(curves)}")


def _row_object(each: RunRow) -> dict[str, Any]:
    row: dict[str, Any] = msgspec.to_builtins(each.row)
    return row


def _setting_text(value: Any) -> str:
    """Format a value as in TOML but without quotes; a dash stands for an absent setting."""
    if isinstance(value, list):
        return ", ".join(map(_setting_text, value))
    if value is None:
        return NOTHING
    return value if isinstance(value, str) else json.dumps(value)


def _shortened(table: Table) -> Table:
    rows = [tuple(shorten(cell, WIDEST, placeholder=" ...") for cell in row) for row in table.rows]
    return Table(table.header, tuple(rows))
