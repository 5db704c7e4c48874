"""All figures of a run: one scenario seen from above, histograms, learning curves."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from skystack.files import make_folder
from skystack.reporting.flights import Outcomes, read_outcomes, read_scenario
from skystack.reporting.histograms import SCENARIOS, Panel, histogram, histograms
from skystack.reporting.learning_curves import learning_curves, success_curves
from skystack.reporting.results import Row, Run, read_run
from skystack.reporting.style import house_style, save
from skystack.reporting.trajectories import picture, pictures

OVERVIEW = (
    "lateral-undamped-plain",
    "lateral-plain",
    "lateral-stacked",
    "lateral-tuned-plain",
    "lateral-tuned-stacked",
    "lateral-best-stacked",
)
"""The rows of the combined picture."""
NOBODY = "do-nothing"


def write_figures(run: Path) -> list[Path]:
    """Draw everything into `figures/`, each as PNG and SVG.

    Raises InputError that names a missing or damaged file.
    """
    whole = read_run(run)
    folder = make_folder(run / "figures")
    with house_style():
        return [path for name, figure in _figures(whole) for path in save(figure, folder / name)]


def typical_scenario(run: Run) -> int:
    """The scenario for the pictures: its clearances lie nearest to every row's own mean.

    Distances are in each row's standard deviations. Where there are scenarios in which every
    policy succeeds, it is one of these.
    """
    flown = {
        row.slug: read_outcomes(run.evaluation(row), SCENARIOS)
        for row in run.results.rows
        if row.experiment != NOBODY
    }
    common = min((len(outcomes.scenario) for outcomes in flown.values()), default=0)
    if not common:
        return 0
    distance = sum(_distance_from_mean(outcomes)[:common] for outcomes in flown.values())
    failed = ~np.all([outcomes.success[:common] for outcomes in flown.values()], axis=0)
    best = np.lexsort((np.asarray(distance), failed))[0]
    return int(next(iter(flown.values())).scenario[best])


def _distance_from_mean(outcomes: Outcomes) -> np.ndarray:
    spread = max(float(outcomes.clearances.std()), 1.0)
    return np.square((outcomes.clearances - outcomes.clearances.mean()) / spread)


def _figures(run: Run) -> Iterator[tuple[str, Figure]]:
    yield from _pictures(run)
    yield from _histograms(run)
    yield from _curves(run)


def _pictures(run: Run) -> Iterator[tuple[str, Figure]]:
    number = typical_scenario(run)
    flown = {row.slug: read_scenario(run.evaluation(row), number) for row in run.results.rows}
    titles = {row.slug: row.title for row in run.results.rows}
    for slug, scenario in flown.items():
        yield f"trajectory-{slug}", picture(titles[slug], scenario)
    together = [(titles[slug], flown[slug]) for slug in OVERVIEW if slug in flown]
    if together:
        yield "trajectories", pictures(together)


def _histograms(run: Run) -> Iterator[tuple[str, Figure]]:
    panels = {row.slug: _panel(run, row) for row in run.results.rows}
    for slug, panel in panels.items():
        yield f"histogram-{slug}", histogram(panel)
    # Zeros only would make the others' bars invisible.
    together = [panels[row.slug] for row in run.results.rows if row.experiment != NOBODY]
    if together:
        yield "histograms", histograms(together)


def _panel(run: Run, row: Row) -> Panel:
    outcomes = read_outcomes(run.evaluation(row), SCENARIOS)
    return Panel(row.title, outcomes.clearances, row.paper.clearances_mean if row.paper else None)


def _curves(run: Run) -> Iterator[tuple[str, Figure]]:
    experiments = {
        name: [
            run.updates(training) for training in run.results.train if training.experiment == name
        ]
        for name in run.results.experiments
    }
    for name, seeds in experiments.items():
        yield f"learning-{name}", learning_curves(experiment_title(name), seeds)
    if experiments:
        titles = {experiment_title(name): seeds for name, seeds in experiments.items()}
        yield "learning", success_curves(titles)


def experiment_title(name: str) -> str:
    """An experiment without a word about stacking, which training does not know."""
    known = {"lateral-undamped": "Undamped", "lateral": "Damped", "lateral-large": "37 actions"}
    known |= {"lateral-tuned": "Tuned", "lateral-best": "Ours"}
    return known.get(name, name)
