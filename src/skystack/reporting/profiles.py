"""Vertical profiles of one scenario: actual and cleared levels over time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skystack.reporting.flights import FlownScenario, Track
from skystack.reporting.labels import Label, place_labels
from skystack.reporting.style import (
    FAINT,
    INK,
    LINES,
    MUTED,
    PAPER,
    SERIES,
    freeze_layout,
    grid_of_axes,
)
from skystack.reporting.trajectories import clearances_text

MINUTES_PER_CYCLE = 0.1


def profile(title: str, scenario: FlownScenario) -> Figure:
    """Draw one flown scenario."""
    return profiles([(title, scenario)])


def profiles(panels: Sequence[tuple[str, FlownScenario]]) -> Figure:
    """Draw several flights of one scenario side by side, on the same axes."""
    size_in = (5.0 * len(panels), 3.7)
    figure, axes = grid_of_axes(1, len(panels), size_in, sharex=True, sharey=True)
    for ax, (title, scenario) in zip(axes, panels, strict=True):
        for number, track in enumerate(scenario.tracks):
            _draw(ax, track, number)
        ax.set_title(f"{title}: {clearances_text(scenario.clearances)}")
        ax.set_xlabel("minutes")
        ax.grid(color=FAINT, linewidth=0.5)
        ax.set_axisbelow(True)
    axes[0].set_ylabel("flight level")
    handles, labels = axes[0].get_legend_handles_labels()
    known = dict(zip(labels, handles, strict=True))
    figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=len(known))
    freeze_layout(figure)
    for ax, (_, scenario) in zip(axes, panels, strict=True):
        _write_texts(ax, scenario)
    return figure


def _write_texts(axes: Axes, scenario: FlownScenario) -> None:
    """Label the clearances that were stacked from several instructions with their number."""
    labels, drawn = [], []
    for number, track in enumerate(scenario.tracks):
        minutes = MINUTES_PER_CYCLE * np.arange(len(track.level_fl))
        drawn += [np.stack([minutes, levels], 1) for levels in (track.level_fl, track.cleared_fl)]
        drawn.append(np.stack([minutes, np.full_like(minutes, track.exit_fl)], 1))
        for issued in track.clearances:
            if issued.kind == "level" and issued.instructions > 1:
                point = (MINUTES_PER_CYCLE * issued.cycle, float(issued.value))
                text = f"{issued.short}: {issued.instructions} instructions"
                labels.append(Label(text, point, SERIES[number % len(SERIES)], size_pt=8.5))
    if labels:
        place_labels(axes, labels, np.concatenate(drawn))


def _draw(axes: Axes, track: Track, number: int) -> None:
    """Draw the actual level, the cleared level and the clearances."""
    colour = SERIES[number % len(SERIES)]
    minutes = [MINUTES_PER_CYCLE * row for row in range(len(track.level_fl))]
    axes.axhline(track.exit_fl, color=INK, linewidth=1.0, linestyle=(0, (4, 2)), label="exit level")
    axes.step(
        minutes, track.cleared_fl, where="post", color=MUTED, linewidth=1.2, label="cleared level"
    )
    style = LINES[number % len(LINES)]
    axes.plot(minutes, track.level_fl, color=colour, linewidth=1.8, linestyle=style, label="level")
    issued = [clearance for clearance in track.clearances if clearance.kind == "level"]
    axes.plot(
        [MINUTES_PER_CYCLE * clearance.cycle for clearance in issued],
        [clearance.value for clearance in issued],
        "o",
        markersize=4.5,
        markerfacecolor=colour,
        markeredgecolor=PAPER,
        markeredgewidth=0.7,
        label="clearance",
    )
