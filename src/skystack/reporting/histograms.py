"""Histograms of the clearances and of the minimum separation per scenario, all seeds together."""

from collections.abc import Sequence
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from skystack.reporting.style import BLUE, FAINT, INK, MUTED, PAPER, grid_of_axes

MAX_BINS = 40
COLUMNS = 2
SHARE_BEYOND = 0.005
SEPARATION_BIN_NM, SEPARATION_MAX_NM = 2.5, 60.0


class Panel(NamedTuple):
    """The data of one histogram."""

    title: str
    clearances: Int[np.ndarray, " scenarios"]
    paper_mean: float | None


def histogram(panel: Panel) -> Figure:
    """Plot the clearances per scenario of one row."""
    figure, (axes,) = grid_of_axes(1, 1, (5.0, 3.1))
    _draw(axes, panel)
    axes.set_xlabel("clearances per scenario")
    axes.set_ylabel("% of scenarios")
    return figure


def histograms(panels: Sequence[Panel]) -> Figure:
    """Plot all rows, two beside each other, each on its own axes.

    On common axes, the bars of a row with few clearances would be too narrow to read, and those of
    the others too low.
    """
    rows = -(-len(panels) // COLUMNS)
    figure, axes = grid_of_axes(rows, COLUMNS, (7.2, 1.75 * rows + 0.4))
    for ax, panel in zip(axes, panels, strict=False):
        _draw(ax, panel)
    for empty in axes[len(panels) :]:
        empty.set_axis_off()
    figure.supylabel("% of scenarios", color=MUTED, fontsize=8.5)
    figure.supxlabel("clearances per scenario", color=MUTED, fontsize=8.5)
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
    most = min(10.0 * np.ceil(farthest / 10.0 + 1e-6), SEPARATION_MAX_NM)
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


def bin_edges(panel: Panel) -> Float[np.ndarray, " edges"]:
    """Edges midway between integers, for nearly all values of a panel and the paper's mean.

    The rest, at most `SHARE_BEYOND`, are counted in the last bin: a few outliers would make all
    others narrow.
    """
    usual = 0
    if panel.clearances.size:  # not interpolated: that would leave out the largest of 100 values
        usual = int(np.quantile(panel.clearances, 1.0 - SHARE_BEYOND, method="inverted_cdf"))
    most = max(usual, ceil(panel.paper_mean or 0.0))
    width = most // MAX_BINS + 1
    return np.arange(0, max(most, 4) + width + 1, width) - 0.5


def _draw(axes: Axes, panel: Panel) -> None:
    edges = bin_edges(panel)
    mean, std = panel.clearances.mean(), panel.clearances.std()
    share = np.full(len(panel.clearances), 100.0 / max(len(panel.clearances), 1))
    bars: dict[str, Any] = {"color": BLUE, "edgecolor": PAPER, "linewidth": 0.6}
    drawn = np.minimum(panel.clearances, edges[-1] - 0.5)
    axes.hist(drawn, bins=list(edges), weights=share, **bars)
    axes.set_title(f"{panel.title}: {mean:.1f} ± {std:.1f}")
    axes.set_xlim(edges[0] - 0.4, edges[-1])
    axes.set_ylim(top=1.3 * axes.get_ylim()[1])  # for the note
    axes.yaxis.set_major_locator(MaxNLocator(nbins=3, integer=True))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=8, steps=[1, 2, 5, 10], integer=True))
    axes.grid(axis="y", color=FAINT, linewidth=0.5)
    axes.set_axisbelow(True)
    axes.text(
        *(0.99, 0.99, _note(panel)),
        transform=axes.transAxes,
        ha="right",
        va="top",
        color=MUTED,
        fontsize=7.5,
    )
    if panel.paper_mean is not None:
        axes.axvline(panel.paper_mean, ymax=0.84, color=INK, linewidth=1.2, linestyle=(0, (4, 2)))


def _note(panel: Panel) -> str:
    """The number of scenarios, and the meaning of the dashed line if there is one."""
    count = f"{len(panel.clearances):,} scenarios"
    beyond = int((panel.clearances > bin_edges(panel)[-1]).sum())
    if beyond:
        count += f", {beyond} beyond"
    if panel.paper_mean is None:
        return count
    return f"{count}; dashed: paper, {panel.paper_mean:.1f}"
