"""Figures of hours of traffic: scores against flights per hour, and survival curves."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from skystack.errors import printable
from skystack.evaluation.hour_row import HourRow
from skystack.platforms.registry import OWN
from skystack.reporting.hour_table import traffic_in_words
from skystack.reporting.style import LINES, SERIES, grid_of_axes

Labelled = Sequence[tuple[str, HourRow]]
"""Rows with the names of their curves."""
COLUMNS = 3
"""The maximum number of survival panels in a row."""


class Measure(NamedTuple):
    """A score that is drawn against flights per hour."""

    title: str
    value: Callable[[HourRow], float | None]
    scale: str = "linear"


def _percent(rate: float | None) -> float | None:
    return None if rate is None else 100.0 * rate


PANELS = (
    Measure(
        "losses of separation per 1,000 flights",
        lambda row: 1000.0 * row.losses_of_separation / row.flights if row.flights else None,
        "symlog",
    ),
    Measure("correct exits, %", lambda row: _percent(row.correct_exit_rate)),
    Measure("transmissions per flight", lambda row: row.transmissions_per_flight),
    Measure("lax score, s", lambda row: row.lax_s_mean),
)


def capacity(rows: Labelled) -> Figure | None:
    """Scores against flights per hour, one curve per name: means over seeds.

    None if no traffic has a rate.
    """
    rated = [(name, row) for name, row in rows if row.flights_per_hour is not None]
    if not rated:
        return None
    figure, panels = grid_of_axes(2, 2, (9.0, 6.4), sharex=True)
    names = _names(rows)
    for axes, panel in zip(panels, PANELS, strict=True):
        axes.set_title(panel.title)
        axes.set_yscale(panel.scale)
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
        for name in names:
            values: dict[float, list[float]] = {}
            for each, row in rated:
                rate, value = row.flights_per_hour, panel.value(row)
                if each == name and rate is not None and value is not None:
                    values.setdefault(rate, []).append(value)
            if values:
                points = [(rate, float(np.mean(found))) for rate, found in sorted(values.items())]
                _curve(axes, names, name, np.array(points))
        axes.margins(y=0.08)
        if not panel.title.startswith("correct"):
            axes.set_ylim(bottom=0.0)
    for axes in panels[2:]:
        axes.set_xlabel("flights per hour")
    _legend(figure, panels)
    return figure


def survival(rows: Labelled) -> Figure:
    """The share of the hours without a failure so far, as the lax score counts it.

    One panel per traffic and simulator.
    """
    names = _names(rows)
    panels = list(dict.fromkeys((row.platform, row.traffic) for _, row in rows))
    panels.sort(key=lambda panel: (panel[0] != OWN, panel[0]))  # stable: traffic keeps its order
    platforms = {platform for platform, _ in panels}
    columns, last_s = min(len(panels), COLUMNS), max(row.length_s for _, row in rows)
    lines = -(-len(panels) // columns)
    size = (max(3.6 * columns, 5.0), 2.9 * lines + 0.5)
    figure, grid = grid_of_axes(lines, columns, size, sharey=True)
    for axes, (platform, traffic) in zip(grid, panels, strict=False):
        where = "" if platforms == {OWN} else f" in {printable(platform)}"
        axes.set_title(traffic_in_words(traffic) + where)
        for name in names:
            key = (name, platform, traffic)
            own = [row for each, row in rows if (each, row.platform, row.traffic) == key]
            if own:
                _curve(axes, names, name, survival_of(own), step=True)
        axes.set_ylim(0.0, 1.04)
        axes.set_xlim(0.0, last_s)
        axes.set_xlabel("time, s")
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    for axes in grid[::columns]:
        axes.set_ylabel("hours without failure")
    _legend(figure, grid)
    return figure


def survival_of(rows: Sequence[HourRow]) -> Float[np.ndarray, "times 2"]:
    """Times, and the share of the hours that have not failed by then.

    An hour without a failure never lowers the curve. Rows may have hours of different lengths.
    """
    ends = [(end, row.length_s) for row in rows for end in row.lax_s_by_hour]
    times = np.unique([0.0, *(end for end, _ in ends)])
    failed = [sum(end <= time and end < length for end, length in ends) for time in times]
    # An hour that fails in its last cycle has the score of a whole hour.
    failed[-1] = max(failed[-1], sum(sum(row.lax_ended_by.values()) for row in rows))
    return np.column_stack([times, 1.0 - np.array(failed) / len(ends)])


def _names(rows: Labelled) -> list[str]:
    return list(dict.fromkeys(name for name, _ in rows))


def _curve(
    axes: Axes,
    names: Sequence[str],
    name: str,
    points: Float[np.ndarray, "points 2"],
    step: bool = False,
) -> None:
    number = names.index(name)
    colour, line = SERIES[number % len(SERIES)], LINES[number // len(SERIES) % len(LINES)]
    marker = "" if step else "o"
    how = "steps-post" if step else "default"
    axes.plot(
        *points.T, color=colour, linestyle=line, marker=marker, ms=4.0, drawstyle=how, label=name
    )


def _legend(figure: Figure, panels: Sequence[Axes]) -> None:
    found: dict[str, Artist] = {}
    for axes in panels:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    figure.legend(list(found.values()), list(found), loc="outside upper left", ncols=3)
