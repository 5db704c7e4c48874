"""What flown hours show of the training objectives of controllers.

    python -m studies.training_objectives [FOLDER ...]

Reads folders of `skystack flight-school` or, if none is given, the stored results of
`studies.flight_school` on `category` traffic. Prints the Markdown tables of
`docs/training-objectives.md`: one table per simulator, one column per controller, one line per
measure.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from skystack.errors import InputError
from skystack.reporting.hours_report import label
from skystack.reporting.table import Table
from skystack.reporting.tables import NOTHING, percent
from studies.hour_results import RESULTS, SOON_S, Result, read_results, result_in


def table_of(results: Sequence[Result]) -> Table:
    """The measures of all controllers."""
    columns: list[tuple[str, ...]] = []
    for result in results:
        values, found = result.row, result.spoken
        losses, rate = values["losses_of_separation"], values["losses_per_flight_hour"]
        later = losses - values["losses_at_birth"]
        columns.append(
            (
                percent(None if found is None else found.again_soon),
                NOTHING if found is None else f"{1.0 + found.combined:.2f}",
                f"{rate * later / losses:.4f}" if later else "0",
                f"{values['close_pairs'] / max(values['flights'], 1):.3f}",
                percent(values["correct_exit_rate"]),
                percent(result.late_entries),
                percent(values["excursion_rate"]),
                f"{values['exit_offset_nm_median'] or 0.0:.1f}",
                percent(values["fail_safe_rate"]),
                f"{values['transmissions_worst_minute']}",
                *(
                    percent(None if found is None else getattr(found, kind))
                    for kind in ("level", "heading", "direct")
                ),
                f"{values['level_offs_per_flight'] or 0.0:.2f}",
                percent(values["extra_miles_rate"]),
            )
        )
    lines = tuple((*measure, *values) for measure, *values in zip(MEASURES, *columns, strict=True))
    return Table(("objective", "measure", *(label(each.hour_row) for each in results)), lines)


MEASURES = (
    ("appropriate clearances", f"transmissions within {SOON_S} s of another to the same flight"),
    ("phraseology", "elements per transmission"),
    ("separation", "losses per flight hour, without those at birth"),
    ("separation", "pairs below 7 NM and 1,000 ft, per flight"),
    ("coordination", "exits at the coordinated boundary and level"),
    ("coordination", "exiting flights that entered in the second half of their flight"),
    ("procedures", "excursions"),
    ("procedures", "distance from the exit fix, NM (median)"),
    ("detecting conflicts", "fail-safe cycles"),
    ("priority of actions", "transmissions in the worst minute"),
    ("choice of separation method", "transmissions with a level"),
    ("choice of separation method", "transmissions with a heading"),
    ("choice of separation method", "transmissions direct to a fix"),
    ("choice of separation method", "level-offs per flight"),
    ("choice of separation method", "extra distance"),
)
"""The objective and the measure of each line."""


def _stored() -> list[Result]:
    """The stored results on `category` traffic."""
    found = [each for each in read_results(RESULTS) if each.hour_row.traffic == "category"]
    if not found:
        raise InputError(
            f"{RESULTS}: contains no results for category traffic (allowed: folders that "
            "flight-school wrote)"
        )
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 success, 2 invalid input."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.training_objectives", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER")
    folders = parser.parse_args(arguments).folders
    try:
        results = [result_in(each) for each in folders] if folders else _stored()
        by_platform: dict[str, list[Result]] = {}
        for result in results:
            by_platform.setdefault(result.hour_row.platform, []).append(result)
        tables = [table_of(each) for each in by_platform.values()]
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    sys.stdout.write("\n".join(table.as_markdown() for table in tables))
    return 0


if __name__ == "__main__":
    sys.exit(main())
