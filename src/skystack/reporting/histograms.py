"""Histograms of the clearances and of the minimum separation per scenario."""

from collections.abc import Sequence
from math import ceil
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from skystack.reporting.style import BLUE, FAINT, INK, MUTED, PAPER, grid_of_axes

SCENARIOS = 100
"""The number of scenarios in the paper's histograms."""
MOST_BINS = 80
SEPARATION_BIN_NM, SEPARATION_MOST_NM = 2.5, 60.0


class Panel(NamedTuple):
    """The data of one histogram."""

    title: str
    clearances: Int[np.ndarray, " scenarios"]
    paper_mean: float | None


def histogram(panel: Panel) -> Figure:
    """Plot the clearances per scenario of one row."""
    figure, (axes,) = grid_of_axes(1, 1, (5.0, 3.1))
    _draw(axes, panel, bin_edges([panel]))
    # There is no room for it next to the title, where `histograms` puts it.
    axes.set_xlabel("\n".join(filter(None, ["clearances per scenario", _dashed(panel)])))
    axes.set_ylabel("scenarios")
    return figure


def histograms(panels: Sequence[Panel]) -> Figure:
    """Plot all rows below each other on the same axes."""
    size_in = (7.2, 1.05 * len(panels) + 0.5)
    figure, axes = grid_of_axes(len(panels), 1, size_in, sharex=True, sharey=True)
    edges = bin_edges(panels)
    for ax, panel in zip(axes, panels, strict=True):
        _draw(ax, panel, edges)
        ax.set_title(_dashed(panel), loc="right", color=MUTED, fontsize=8.0, fontweight="normal")
    figure.supylabel("scenarios", color=MUTED, fontsize=8.5)
    axes[-1].set_xlabel("clearances per scenario")
    return figure


class Nearest(NamedTuple):
    """The minimum separation in each scenario of one row."""

    title: str
    separation_nm: Float[np.ndarray, " scenarios"]
    lost: int
    """The number of scenarios with a loss of separation."""
    standard_nm: float
    """The separation standard."""


def separations(panels: Sequence[Nearest]) -> Figure:
    """Plot the minimum separation per scenario, all rows below each other on the same axes."""
    size_in = (7.2, 1.2 * len(panels) + 0.5)
    figure, axes = grid_of_axes(len(panels), 1, size_in, sharex=True, sharey=True)
    farthest = max(float(panel.separation_nm.max()) for panel in panels)
    most = min(10.0 * np.ceil(farthest / 10.0 + 1e-6), SEPARATION_MOST_NM)
    edges = np.arange(0.0, most + SEPARATION_BIN_NM, SEPARATION_BIN_NM)
    for ax, panel in zip(axes, panels, strict=True):
        shown = np.minimum(panel.separation_nm, most - 1e-6)
        ax.hist(shown, bins=list(edges), color=BLUE, edgecolor=PAPER, linewidth=0.6)
        ax.axvline(panel.standard_nm, color=INK, linewidth=1.2, linestyle=(0, (4, 2)))
        ax.set_title(f"{panel.title}: {panel.lost} of {len(shown)} below {panel.standard_nm:g} NM")
        ax.yaxis.set_major_locator(MaxNLocator(nbins=3, integer=True))
        ax.grid(axis="y", color=FAINT, linewidth=0.5)
        ax.set_axisbelow(True)
    figure.supylabel("scenarios", color=MUTED, fontsize=8.5)
    beyond = f" (last bar: {edges[-2]:g} and more)" if farthest > most else ""
    axes[-1].set_xlabel(f"minimum separation per scenario, NM{beyond}")
    axes[-1].set_xlim(edges[0], edges[-1])
    return figure


def bin_edges(panels: Sequence[Panel]) -> Float[np.ndarray, " edges"]:
    """Edges midway between integers, for the values of all panels and the paper's means."""
    most = max(
        max(int(panel.clearances.max(initial=0)), ceil(panel.paper_mean or 0.0)) for panel in panels
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
    """The meaning of the dashed line; empty if there is none."""
    return "" if panel.paper_mean is None else f"dashed: the paper's mean, {panel.paper_mean:.1f}"
