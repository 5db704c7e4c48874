"""How many clearances scenarios take: histograms beside the paper's mean."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from skystack.reporting.style import BLUE, FAINT, INK, MUTED, PAPER, grid_of_axes

SCENARIOS = 100
"""As many as the paper's histograms show."""
MOST_BINS = 80
SEPARATION_BIN_NM, SEPARATION_MOST_NM = 2.5, 60.0


class Panel(NamedTuple):
    """What one histogram shows."""

    title: str
    clearances: Int[np.ndarray, " scenarios"]
    paper_mean: float | None


def histogram(panel: Panel) -> Figure:
    """One row's clearances per scenario."""
    figure, (axes,) = grid_of_axes(1, 1, (5.0, 3.1))
    _draw(axes, panel, bin_edges([panel]))
    # Beside the title, as in the picture of all rows, there is no room for it.
    axes.set_xlabel("\n".join(filter(None, ["clearances in a scenario", _dashed(panel)])))
    axes.set_ylabel("scenarios")
    return figure


def histograms(panels: Sequence[Panel]) -> Figure:
    """All rows below each other on the same axes."""
    size_in = (7.2, 1.05 * len(panels) + 0.5)
    figure, axes = grid_of_axes(len(panels), 1, size_in, sharex=True, sharey=True)
    edges = bin_edges(panels)
    for place, panel in zip(axes, panels, strict=True):
        _draw(place, panel, edges)
        place.set_title(_dashed(panel), loc="right", color=MUTED, fontsize=8.0, fontweight="normal")
    figure.supylabel("scenarios", color=MUTED, fontsize=8.5)
    axes[-1].set_xlabel("clearances in a scenario")
    return figure


class Nearest(NamedTuple):
    """How near the aircraft of each scenario came."""

    title: str
    separation_nm: Float[np.ndarray, " scenarios"]
    lost: int
    """Scenarios with a loss of separation."""
    standard_nm: float
    """The least distance allowed."""


def separations(panels: Sequence[Nearest]) -> Figure:
    """The least separation of each scenario, all rows below each other on the same axes."""
    size_in = (7.2, 1.2 * len(panels) + 0.5)
    figure, axes = grid_of_axes(len(panels), 1, size_in, sharex=True, sharey=True)
    farthest = max(float(panel.separation_nm.max()) for panel in panels)
    most = min(10.0 * np.ceil(farthest / 10.0 + 1e-6), SEPARATION_MOST_NM)
    edges = np.arange(0.0, most + SEPARATION_BIN_NM, SEPARATION_BIN_NM)
    for place, panel in zip(axes, panels, strict=True):
        shown = np.minimum(panel.separation_nm, most - 1e-6)
        place.hist(shown, bins=list(edges), color=BLUE, edgecolor=PAPER, linewidth=0.6)
        place.axvline(panel.standard_nm, color=INK, linewidth=1.2, linestyle=(0, (4, 2)))
        place.set_title(
            f"{panel.title}: {panel.lost} of {len(shown)} below {panel.standard_nm:g} NM"
        )
        place.yaxis.set_major_locator(MaxNLocator(nbins=3, integer=True))
        place.grid(axis="y", color=FAINT, linewidth=0.5)
        place.set_axisbelow(True)
    figure.supylabel("scenarios", color=MUTED, fontsize=8.5)
    beyond = f" (the last bar: {edges[-2]:g} and more)" if farthest > most else ""
    axes[-1].set_xlabel(f"least separation in a scenario, NM{beyond}")
    axes[-1].set_xlim(edges[0], edges[-1])
    return figure


def bin_edges(panels: Sequence[Panel]) -> Float[np.ndarray, " edges"]:
    """Edges half-way between whole numbers, for every panel's values and the paper's means."""
    most = max(
        max(int(panel.clearances.max(initial=0)), int(panel.paper_mean or 0)) for panel in panels
    )
    width = most // MOST_BINS + 1
    return np.arange(0, max(most, 4) + width + 1, width) - 0.5


def _draw(axes: Axes, panel: Panel, edges: Float[np.ndarray, " edges"]) -> None:
    mean, std = panel.clearances.mean(), panel.clearances.std()
    axes.hist(panel.clearances, bins=list(edges), color=BLUE, edgecolor=PAPER, linewidth=0.6)
    axes.set_title(f"{panel.title}: {mean:.1f} ± {std:.1f}")
    axes.set_xlim(edges[0] - 0.4, edges[-1])
    axes.yaxis.set_major_locator(MaxNLocator(nbins=3, integer=True))
    axes.xaxis.set_major_locator(MaxNLocator(steps=[1, 2, 5, 10], integer=True))
    axes.grid(axis="y", color=FAINT, linewidth=0.5)
    axes.set_axisbelow(True)
    if panel.paper_mean is not None:
        axes.axvline(panel.paper_mean, color=INK, linewidth=1.2, linestyle=(0, (4, 2)))


def _dashed(panel: Panel) -> str:
    """What the dashed line means, where there is one."""
    return "" if panel.paper_mean is None else f"dashed: the paper's mean, {panel.paper_mean:.1f}"
