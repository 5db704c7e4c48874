"""`report.html`: a self-contained report on a run, with its tables, figures and claims."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from skystack.io.files import TEMPORARY_SUFFIX, atomic_write, publish, scratch_folder
from skystack.learning.experiment import experiment_names
from skystack.reporting import tables
from skystack.reporting.claims import Claim, check_claims, claims_table
from skystack.reporting.families import BOUND_FAMILY, family_title
from skystack.reporting.figures import (
    OVERVIEW,
    experiment_title,
    write_figures,
)
from skystack.reporting.flights import FlownScenario, IssuedClearance, read_scenario
from skystack.reporting.headline import headline
from skystack.reporting.markdown import as_markdown
from skystack.reporting.page import Picture, picture_of, render
from skystack.reporting.replay.page import write_replay
from skystack.reporting.results import TRAINED_MARGIN, Bound, Row, Run, read_run
from skystack.reporting.table import Table
from skystack.reporting.trajectories import clearances_text
from skystack.reporting.typical import CANDIDATES, kind_of_scenario, typical_scenario

SETTING = {
    "loop": "Policy, online action-stacking and simulator, and the data they exchange",
    "sector": "The sector: its area, airways and fixes",
    "routes": "The routes through the sector from each of its first fixes",
}
"""The pictures that introduce the task, with their alternative texts."""


class RowSection(NamedTuple):
    """The section of the report on one row."""

    title: str
    is_open: bool
    """Whether it is unfolded at first: the rows of the overview are."""
    flights: Picture
    histogram: Picture
    clearances: str
    issued: tuple[IssuedClearance, ...]
    """In the order of issue, all aircraft together."""


Pictures = Mapping[str, str]
"""The SVG texts of the figures by name."""


class FamilySection(NamedTuple):
    """The section of the report on the experiments of one task."""

    name: str
    title: str
    brief: Table
    comparison: Table
    estimates: Table
    claims: Table
    bound: Bound | None
    scenario: int
    """The number of the scenario that is drawn."""
    kind: str | None
    """What the scenario has in common with the paper's, in words; None if nothing."""
    replay: str | None
    """The file with the replay of the scenario, if there is one."""
    tuned_missing: bool
    """Whether the run lacks the family's experiment with changed settings."""
    sections: tuple[RowSection, ...]
    histograms: Picture | None
    separations: Picture | None
    convergence: Picture | None
    success: Picture | None
    curves: tuple[Picture, ...]


class Tile(NamedTuple):
    """A headline number at the top of the report."""

    name: str
    value: str
    notes: tuple[str, ...]


def write_report(run: Path) -> Path:
    """Write `figures/`, `results.md`, replays and `report.html`; return the path of the report.

    Raises InputError that names a missing or damaged file. The files of an earlier report are then
    unchanged.
    """
    contents = read_run(run)
    with scratch_folder(".report.", run, TEMPORARY_SUFFIX) as scratch:
        drawn = write_figures(run, scratch / "figures")
        pictures = {path.stem: path.read_text("utf-8") for path in drawn if path.suffix == ".svg"}
        atomic_write(scratch / "results.md", as_markdown(contents).encode())
        replays = {
            family: _write_replay(contents, family, rows, scratch)
            for family, rows in contents.results.families.items()
        }
        atomic_write(scratch / "report.html", _page(contents, pictures, replays))
        publish(scratch, run)
    return run / "report.html"


def _write_replay(run: Run, family: str, rows: Sequence[Row], folder: Path) -> str | None:
    """Write the replay of a family's scenario, one policy without and with stacking, if flown.

    Returns the name of the file in the folder.
    """
    flown = [row for row in run.results.drawn(rows) if not row.is_no_op and not row.is_shipped]
    stacked = [row for row in flown if row.stacking]
    if not stacked:
        return None
    last = stacked[-1]
    plain = [row for row in flown if (row.experiment, row.stacking) == (last.experiment, False)]
    name = f"replay-{family}.html"
    shown = [run.evaluation(row) for row in (*plain, last)]
    write_replay(shown, folder / name, only=typical_scenario(run, rows))
    return name


def _page(run: Run, pictures: Pictures, replays: Mapping[str, str | None]) -> bytes:
    results, claims = run.results, check_claims(run)
    return render(
        "report.html.jinja",
        results=results,
        headline=list(headline(run)),
        tiles=_tiles(run),
        setting={
            name: _picture(pictures, name, SETTING[name]) for name in SETTING if name in pictures
        },
        families=[
            _family(run, pictures, claims, *family)._replace(replay=replays[family[0]])
            for family in results.families.items()
        ],
        platforms=tables.platforms(results.platforms),
        comparisons=tables.comparisons(results),
        sampled=tables.sampled(results),
        flown_in={row.platform for row in results.platforms},
        several_seeds=_several_seeds(results.rows),
        by_seed=tables.by_seed(results) if _several_seeds(results.rows) else None,
        margin=f"{100.0 * TRAINED_MARGIN:.0f}",
        trainings=tables.trainings(results),
        took=tables.duration(results.wall_s),
        candidates=CANDIDATES,
    )


def _several_seeds(rows: Sequence[Row]) -> bool:
    """Whether a row covers several seeds; otherwise results by seed would repeat the rows."""
    return any(row.seeds > 1 for row in rows)


def _family(
    run: Run, pictures: Pictures, claims: Sequence[Claim], family: str, rows: list[Row]
) -> FamilySection:
    scenario, drawn_rows = typical_scenario(run, rows), run.results.drawn(rows)
    bound = run.bound_of(family)

    def if_drawn(name: str, words: str) -> Picture | None:
        return _picture(pictures, name, words) if name in pictures else None

    return FamilySection(
        name=family,
        title=family_title(family),
        brief=tables.brief(rows, bound, run.results.is_trained),
        comparison=tables.comparison(rows, bound, run.results.is_trained),
        estimates=tables.estimates(rows),
        claims=claims_table([claim for claim in claims if claim.family == family]),
        bound=bound,
        scenario=scenario,
        kind=kind_of_scenario(run, rows, scenario),
        replay=None,
        tuned_missing=_tuned_missing(run, family),
        sections=tuple(_section(run, pictures, row, scenario) for row in drawn_rows),
        histograms=if_drawn(f"histograms-{family}", "Clearances per scenario, all rows"),
        separations=if_drawn(f"separations-{family}", "Minimum separation per scenario"),
        convergence=if_drawn(
            f"convergence-{family}", "Return and success during training: 5 and 37 actions"
        ),
        success=if_drawn(f"success-{family}", "Success during training, all experiments"),
        curves=tuple(
            _picture(pictures, f"learning-{name}", f"Learning curves: {experiment_title(name)}")
            for name in run.results.experiments_of(family)
        ),
    )


def _tuned_missing(run: Run, family: str) -> bool:
    """Whether the run lacks an existing experiment with changed settings."""
    tuned = f"{family}-tuned"
    return tuned in experiment_names() and run.results.row(tuned, True) is None


def _tiles(run: Run) -> list[Tile]:
    """A tile for each row of the combined pictures, and one for the fewest possible clearances."""
    overview = _overview()
    tiles = [
        Tile(
            row.title,
            tables.decimal(row.clearances_mean),
            (
                f"{tables.percent(row.success_rate)} success",
                *([f"paper {tables.decimal(row.paper.clearances_mean)}"] if row.paper else []),
            ),
        )
        for row in run.results.rows
        if row.slug in overview and not row.is_no_op and run.results.is_trained(row)
    ]
    if run.bound is not None and BOUND_FAMILY in run.results.families:
        value = tables.decimal(run.bound.clearances_mean)
        tiles.append(Tile("Fewest possible, lateral", value, ("10-degree turns",)))
    return tiles


def _overview() -> set[str]:
    """The rows of the combined pictures."""
    return {slug for slugs in OVERVIEW.values() for slug in slugs}


def _section(run: Run, pictures: Pictures, row: Row, number: int) -> RowSection:
    scenario = read_scenario(run.evaluation(row), number)
    issued = [clearance for track in scenario.tracks for clearance in track.clearances]
    return RowSection(
        title=row.title,
        is_open=row.slug in _overview() or row.family not in OVERVIEW,
        flights=_picture(pictures, f"trajectory-{row.slug}", _alternative_text(scenario)),
        histogram=_picture(
            pictures, f"histogram-{row.slug}", f"Histogram of clearances per scenario: {row.name}"
        ),
        clearances=clearances_text(scenario.clearances),
        issued=tuple(sorted(issued, key=lambda clearance: clearance.cycle)),
    )


def _alternative_text(scenario: FlownScenario) -> str:
    """The alternative text of the picture of a scenario."""
    flights = "; ".join(
        f"{track.callsign} with {clearances_text(len(track.clearances))}"
        f"{'' if track.excursion_cycle is None else ' and an excursion'}"
        for track in scenario.tracks
    )
    return f"Scenario {scenario.number}: {flights}"


def _picture(pictures: Pictures, name: str, words: str) -> Picture:
    return picture_of(pictures[name], words)
