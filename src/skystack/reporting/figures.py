"""The figures of a run: sector, one scenario per family, histograms, learning curves."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from skystack.io.files import make_folder
from skystack.reporting.flights import FlownScenario, read_outcomes, read_scenario, read_sector
from skystack.reporting.histograms import (
    Nearest,
    Panel,
    histogram,
    histograms,
    separations,
)
from skystack.reporting.learning_curves import convergence, learning_curves, success_curves
from skystack.reporting.loop import loop
from skystack.reporting.maps import route_maps, sector_map
from skystack.reporting.profiles import profile, profiles
from skystack.reporting.results import Row, Run, read_run
from skystack.reporting.style import house_style, save
from skystack.reporting.trajectories import picture, pictures
from skystack.reporting.typical import typical_scenario

OVERVIEW = {
    "lateral": (
        "lateral-undamped-plain",
        "lateral-plain",
        "lateral-stacked",
        "lateral-tuned-plain",
        "lateral-tuned-stacked",
        "lateral-best-stacked",
        "do-nothing-lateral-plain",
        "do-nothing-plain",  # in old files
    ),
    "vertical": ("vertical-plain", "vertical-stacked"),
    "avoidance": (
        "avoidance-plain",
        "avoidance-stacked",
        "avoidance-large-plain",
        "avoidance-tuned-stacked",
        "avoidance-best-stacked",
    ),
}
"""The rows in the combined picture of a family; other families show all rows."""
HISTOGRAMS = {"lateral": {*OVERVIEW["lateral"], "lateral-large-plain", "lateral-best-plain"}}
"""The rows in the combined histograms, where these are not all."""


def write_figures(run: Path, folder: Path | None = None) -> list[Path]:
    """Draw all figures of a run into a folder, by default its `figures/`, as PNG and SVG.

    Raises InputError that names a missing or damaged file.
    """
    with house_style():
        figures = list(_figures(read_run(run)))  # read everything before writing
        folder = make_folder(run / "figures" if folder is None else folder)
        return [path for name, figure in figures for path in save(figure, folder / name)]


def _figures(run: Run) -> Iterator[tuple[str, Figure]]:
    yield "loop", loop()
    if run.results.rows:
        sector = read_sector(run.evaluation(run.results.rows[0]))
        yield "sector", sector_map(sector)
        yield "routes", route_maps(sector)
    for family, rows in run.results.families.items():
        drawn = run.results.drawn(rows)
        yield from _pictures(run, family, drawn)
        yield from _histograms(run, family, drawn)
        yield from _curves(run, family)


_DrawOne = Callable[[str, FlownScenario], Figure]
_DrawSeveral = Callable[[Sequence[tuple[str, FlownScenario]]], Figure]
_DRAWN_AS: Mapping[str, tuple[_DrawOne, _DrawSeveral]] = {
    "vertical": (profile, profiles),
    "avoidance": (partial(picture, separation=True), partial(pictures, separation=True)),
}
"""The functions that draw one flight and several; the default is the plan view."""


def _pictures(run: Run, family: str, rows: Sequence[Row]) -> Iterator[tuple[str, Figure]]:
    number = typical_scenario(run, rows)
    flown = {row.slug: read_scenario(run.evaluation(row), number) for row in rows}
    titles = {row.slug: row.title for row in rows}
    one, several = _DRAWN_AS.get(family, (picture, pictures))
    for slug, scenario in flown.items():
        yield f"trajectory-{slug}", one(titles[slug], scenario)
    chosen = OVERVIEW.get(family, tuple(flown))
    together = [(titles[slug], flown[slug]) for slug in chosen if slug in flown]
    if together:
        yield f"trajectories-{family}", several(together)


def _histograms(run: Run, family: str, rows: Sequence[Row]) -> Iterator[tuple[str, Figure]]:
    panels = {row.slug: _panel(run, row) for row in rows}
    for slug, panel in panels.items():
        yield f"histogram-{slug}", histogram(panel)
    # Doing nothing has no clearances, and a shipped policy repeats the row of its experiment.
    acting = [row for row in rows if not row.is_no_op and not row.is_shipped]
    if acting:
        chosen = HISTOGRAMS.get(family, {row.slug for row in acting})
        rows_shown = [row for row in acting if row.slug in chosen] or acting
        yield f"histograms-{family}", histograms([panels[row.slug] for row in rows_shown])
    if acting and family == "avoidance":
        yield f"separations-{family}", separations([_nearest(run, row) for row in acting])


def _nearest(run: Run, row: Row) -> Nearest:
    outcomes = [read_outcomes(folder) for folder in run.evaluations(row)]
    sector = read_sector(run.evaluation(row))
    lost = sum(int(each.loss_of_separation.sum()) for each in outcomes)
    separation_nm = np.concatenate([each.min_separation_nm for each in outcomes])
    return Nearest(row.title, separation_nm, lost, sector.separation_nm)


def _panel(run: Run, row: Row) -> Panel:
    counts = [read_outcomes(folder).clearances for folder in run.evaluations(row)]
    return Panel(
        row.title, np.concatenate(counts), row.paper.clearances_mean if row.paper else None
    )


def _curves(run: Run, family: str) -> Iterator[tuple[str, Figure]]:
    experiments = {
        name: [
            run.updates(training) for training in run.results.train if training.experiment == name
        ]
        for name in run.results.experiments_of(family)
    }
    for name, seeds in experiments.items():
        yield f"learning-{name}", learning_curves(experiment_title(name), seeds)
    if experiments:
        titles = {experiment_title(name): seeds for name, seeds in experiments.items()}
        yield f"success-{family}", success_curves(titles)
    small, large = experiments.get(family), experiments.get(f"{family}-large")
    if small and large:
        both = {"5 actions": small, "37 actions": large}
        yield f"convergence-{family}", convergence(both)


def experiment_title(name: str) -> str:
    """The title of an experiment. It omits stacking, which is not part of training."""
    known = {"lateral-undamped": "Undamped", "lateral": "Damped", "lateral-large": "37 actions"}
    known |= {"lateral-tuned": "Tuned", "lateral-best": "Ours", "vertical": "Vertical control"}
    known |= {"avoidance": "5 actions", "avoidance-large": "37 actions"}
    known |= {"avoidance-tuned": "Tuned", "avoidance-best": "Ours"}
    return known.get(name, name)
