"""Plan views of one scenario: the sector, the flights and the clearances."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from skystack.reporting.flights import FlownScenario, IssuedClearance, Track
from skystack.reporting.labels import Label, place_labels
from skystack.reporting.maps import along, draw_sector, name_axes
from skystack.reporting.style import (
    INK,
    LINES,
    MUTED,
    PAPER,
    SERIES,
    freeze_layout,
    grid_of_axes,
)

MAX_TEXTS = 20
"""With more bursts than this, only marks are drawn, as texts would hide the flights."""

NEAREST: dict[str, Any] = {
    "color": INK,
    "linewidth": 1.0,
    "marker": "s",
    "markersize": 4.5,
    "markerfacecolor": PAPER,
    "markeredgewidth": 1.0,
}
"""The style of the line between two aircraft at their closest approach."""


def picture(title: str, scenario: FlownScenario, separation: bool = False) -> Figure:
    """Draw one scenario; with `separation`, mark the closest approach of the aircraft."""
    figure, (axes,) = grid_of_axes(1, 1, (5.0, 4.4))
    _draw(axes, title, scenario, separation)
    _legend(figure, [scenario], separation)
    freeze_layout(figure)
    _write_texts(axes, scenario, separation)
    return figure


def pictures(panels: Sequence[tuple[str, FlownScenario]], separation: bool = False) -> Figure:
    """Draw several flights of one scenario side by side, two or three in a row."""
    columns = min(len(panels), 2 if len(panels) <= 4 else 3)
    rows = -(-len(panels) // columns)
    figure, axes = grid_of_axes(
        rows, columns, (5.0 * columns, 4.5 * rows + 0.3), sharex=True, sharey=True
    )
    for ax, (title, scenario) in zip(axes, panels, strict=False):
        _draw(ax, title, scenario, separation)
        ax.label_outer()
    for empty in axes[len(panels) :]:
        empty.set_axis_off()
    _legend(figure, [scenario for _, scenario in panels], separation)
    freeze_layout(figure)
    for ax, (_, scenario) in zip(axes, panels, strict=False):
        _write_texts(ax, scenario, separation)
    return figure


def clearances_text(count: int) -> str:
    """Format as `7 clearances` or `1 clearance`."""
    return f"{count} clearance" if count == 1 else f"{count} clearances"


def _draw(axes: Axes, title: str, scenario: FlownScenario, separation: bool) -> None:
    draw_sector(axes, scenario.sector)
    crowded = _is_crowded(scenario)
    for number, track in enumerate(scenario.tracks):
        _draw_track(axes, track, number, crowded)
    if separation and (nearest := scenario.least_separation):
        axes.plot(*nearest.position_nm.T, **NEAREST, zorder=7)
    axes.set_title(f"{title}: {clearances_text(scenario.clearances)}")
    name_axes(axes)


def _draw_track(axes: Axes, track: Track, number: int, crowded: bool) -> None:
    colour = SERIES[number % len(SERIES)]
    path = track.position_nm
    # A broad band under the flight shows the planned route, so that deviations are visible.
    axes.plot(
        *track.route_nm.T,
        color=colour,
        linewidth=7.0,
        alpha=0.13,
        zorder=2.5,
        solid_capstyle="butt",
    )
    axes.plot(*path.T, color=colour, linewidth=1.6, linestyle=LINES[number % len(LINES)], zorder=4)
    axes.plot(
        *path[0],
        "o",
        markersize=7.0,
        markerfacecolor=PAPER,
        markeredgecolor=colour,
        markeredgewidth=1.6,
        zorder=5,
    )
    east, north = path[-1] - path[max(len(path) - 3, 0)]
    heading_deg = np.degrees(np.arctan2(east, north))
    axes.plot(*path[-1], marker=(3, 0, -heading_deg), markersize=8.0, color=colour, zorder=5)
    axes.plot(
        *_points(track, track.clearances).T,
        "o",
        markersize=3.6 if crowded else 5.2,
        markerfacecolor=colour,
        markeredgecolor=PAPER,
        markeredgewidth=0.5 if crowded else 0.8,
        zorder=6,
    )
    if track.excursion_cycle is not None:
        axes.plot(
            *path[track.excursion_cycle],
            "X",
            markersize=9.0,
            markerfacecolor=INK,
            markeredgecolor=PAPER,
            zorder=7,
        )


def _write_texts(axes: Axes, scenario: FlownScenario, separation: bool) -> None:
    """Write the texts. This comes last, because texts go where nothing is drawn."""
    nearest = scenario.least_separation if separation else None
    labels = [
        Label(name, _pair(point), MUTED, size_pt=7.0, distances_pt=(4.0, 7.0, 11.0, 16.0, 24.0))
        for name, point in scenario.sector.fixes_nm.items()
    ]
    labels += [
        Label(
            track.callsign,
            _pair(track.position_nm[0]),
            SERIES[number % len(SERIES)],
            size_pt=8.5,
            weight="bold",
        )
        for number, track in enumerate(scenario.tracks)
    ]
    if nearest is not None:
        middle = _pair(nearest.position_nm.mean(axis=0))
        labels.append(Label(f"{nearest.distance_nm:.1f} NM", middle, INK, 8.5, "bold"))
    if not _is_crowded(scenario):
        for number, track in enumerate(scenario.tracks):
            colour = SERIES[number % len(SERIES)]
            for burst in track.bursts:
                # The text belongs to the middle of the burst, with marks on both sides.
                point = _points(track, burst[len(burst) // 2 : len(burst) // 2 + 1])[0]
                labels.append(Label(burst_text(burst), _pair(point), colour))
    drawn = [track.position_nm for track in scenario.tracks]
    # Marks are larger than lines, so their points count three times.
    drawn += [_points(track, track.clearances).repeat(3, axis=0) for track in scenario.tracks]
    drawn += [np.array(list(scenario.sector.fixes_nm.values())).repeat(3, axis=0)]
    if nearest is not None:
        drawn.append(along(nearest.position_nm))
    place_labels(axes, labels, np.concatenate(drawn))


def burst_text(burst: Sequence[IssuedClearance]) -> str:
    """Format as `right 285`, or as `7 clearances to 285` for consecutive clearances."""
    last = burst[-1]
    if len(burst) == 1:
        return last.short
    return f"{clearances_text(len(burst))} to {last.target}"


def _is_crowded(scenario: FlownScenario) -> bool:
    return sum(len(track.bursts) for track in scenario.tracks) > MAX_TEXTS


def _points(
    track: Track, clearances: Sequence[IssuedClearance]
) -> Float[np.ndarray, "clearances 2"]:
    """The positions of the aircraft when the clearances were issued."""
    last = len(track.position_nm) - 1
    return track.position_nm[[min(clearance.cycle, last) for clearance in clearances]]


def _pair(point: Float[np.ndarray, "2"]) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _legend(figure: Figure, scenarios: Sequence[FlownScenario], separation: bool) -> None:
    tracks = [track for scenario in scenarios for track in scenario.tracks]
    handles = [
        Line2D([], [], marker="o", ls="", mfc=PAPER, mec=INK, mew=1.4, ms=6.5, label="start"),
        Line2D([], [], marker="o", ls="", mfc=INK, mec=PAPER, ms=5.5, label="clearance"),
        Line2D([], [], marker=(3, 0, -90), ls="", color=INK, ms=7.0, label="end"),
        Line2D(
            [], [], color=MUTED, lw=7.0, alpha=0.3, solid_capstyle="butt", label="planned route"
        ),
    ]
    if separation and any(scenario.least_separation for scenario in scenarios):
        handles.append(Line2D([], [], **NEAREST, label="minimum separation"))
    if any(track.excursion_cycle is not None for track in tracks):
        handles.append(
            Line2D([], [], marker="X", ls="", mfc=INK, mec=PAPER, ms=8.5, label="excursion")
        )
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=len(handles),
        handletextpad=0.6,
        columnspacing=1.6,
    )
