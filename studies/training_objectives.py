"""What flown hours show of the training objectives of controllers.

    python -m studies.training_objectives FOLDER ...

Reads folders of `skystack flight-school` and prints the Markdown table of
`docs/training-objectives.md`: one column per controller, one line per measure.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa

from skystack.errors import InputError
from skystack.evaluation.hour_row import FILE
from skystack.evaluation.stored import read_table
from skystack.io.json_file import read_json
from skystack.reporting.hours_report import label, read_hours
from skystack.reporting.table import Table
from skystack.reporting.tables import percent
from skystack.simulator.simulator import CYCLE_S

SOON_S = 60
"""A further transmission to a flight within this time could have been part of the one before."""
KINDS = ("level", "heading", "direct")
COLUMNS = ("scenario", "cycle", "transmission", "callsign", "kind")


class Spoken(NamedTuple):
    """Shares of the transmissions."""

    again_soon: float
    """Within `SOON_S` of another transmission to the same flight."""
    level: float
    """With a level."""
    heading: float
    direct: float
    combined: float
    """With a level, and a heading or a fix."""


def spoken(clearances: pa.Table) -> Spoken | None:
    """What was transmitted; None if nothing was."""
    if not clearances.num_rows:
        return None
    keys = ["scenario", "transmission", "callsign", "cycle"]
    kinds = clearances.group_by(keys).aggregate([("kind", "list")]).sort_by(
        [("scenario", "ascending"), ("callsign", "ascending"), ("cycle", "ascending")]
    )  # fmt: skip
    total, parts = kinds.num_rows, kinds["kind_list"].to_pylist()
    flights = list(zip(kinds["scenario"].to_pylist(), kinds["callsign"].to_pylist(), strict=True))
    cycles = kinds["cycle"].to_pylist()
    again = sum(
        flights[at] == flights[at - 1] and (cycles[at] - cycles[at - 1]) * CYCLE_S <= SOON_S
        for at in range(1, total)
    )

    def share(kind: str) -> float:
        return sum(kind in each for each in parts) / total

    combined = sum(len(each) > 1 for each in parts) / total
    return Spoken(again / total, share("level"), share("heading"), share("direct"), combined)


def table_of(folders: Sequence[Path]) -> Table:
    """The measures of all controllers. Raises InputError for folders that cannot be read."""
    columns: list[tuple[str, ...]] = []
    names = []
    for folder in folders:
        (row,), values = read_hours([folder]), read_json(folder / FILE)
        found = spoken(_clearances(folder))
        losses, rate = values["losses_of_separation"], values["losses_per_flight_hour"]
        avoidable = losses - values["losses_at_birth"]
        names.append(label(row))
        columns.append(
            (
                percent(found and found.again_soon),
                "1.00" if found is None else f"{1.0 + found.combined:.2f}",
                f"{rate * avoidable / losses:.4f}" if avoidable else "0",
                f"{values['close_pairs'] / max(values['flights'], 1):.3f}",
                percent(values["correct_exit_rate"]),
                percent(values["excursion_rate"]),
                f"{values['exit_offset_nm_median'] or 0.0:.1f}",
                percent(values["fail_safe_rate"]),
                f"{values['transmissions_worst_minute']}",
                *(
                    percent(found and getattr(found, kind))
                    for kind in ("level", "heading", "direct")
                ),
                f"{values['level_offs_per_flight'] or 0.0:.2f}",
                percent(values["extra_miles_rate"]),
            )
        )
    lines = tuple((*measure, *values) for measure, *values in zip(MEASURES, *columns, strict=True))
    return Table(("objective", "measure", *names), lines)


MEASURES = (
    ("appropriate clearances", f"transmissions within {SOON_S} s of another to the same flight"),
    ("phraseology", "elements per transmission"),
    ("separation", "losses per flight hour, without those at birth"),
    ("separation", "pairs below 7 NM and 1,000 ft, per flight"),
    ("coordination", "exits at the coordinated boundary and level"),
    ("procedures", "excursions"),
    ("procedures", "distance from the exit fix, NM (median)"),
    ("detecting conflicts", "fail-safe cycles"),
    ("priority of actions", "transmissions in the worst minute"),
    ("choice of method", "transmissions with a level"),
    ("choice of method", "transmissions with a heading"),
    ("choice of method", "transmissions direct to a fix"),
    ("choice of method", "level-offs per flight"),
    ("choice of method", "extra distance"),
)
"""The objective and the measure of each line."""


def _clearances(folder: Path) -> pa.Table:
    table = read_table(folder / "clearances.parquet", COLUMNS)
    texts = {name: table[name].cast(pa.string()) for name in ("callsign", "kind")}
    for name, column in texts.items():
        table = table.set_column(table.column_names.index(name), name, column)
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 success, 2 invalid input."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.training_objectives", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    try:
        table = table_of(parser.parse_args(arguments).folders)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write(table.as_markdown())
    return 0


if __name__ == "__main__":
    sys.exit(main())
