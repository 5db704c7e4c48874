"""The radar picture of a scenario as an array of pixels; needs no display."""

from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patheffects import withStroke

from skystack.airspace.sector import Sector
from skystack.errors import InputError
from skystack.reporting.maps import draw_sector, name_axes, name_fixes
from skystack.reporting.style import INK, PAPER, SERIES, grid_of_axes, house_style, settle
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S
from skystack.simulator.traffic import Traffic, callsigns
from skystack.tasks.contract import TaskState

SIZE_IN, PIXELS_PER_INCH = (7.2, 6.8), 100
AHEAD_MIN = 2.0
"""How far ahead of an aircraft its heading line shows it."""
LABEL_PT = 9.0
"""How far from an aircraft its label stands."""


@runtime_checkable
class Visible(Protocol):
    """A task with something to be seen."""

    @property
    def name(self) -> str: ...

    @property
    def sector(self) -> Sector: ...

    def traffic(self, state: TaskState) -> Traffic: ...


class Radar:
    """Follows one scenario and draws it.

    Each aircraft has its callsign with its level, actual and cleared, the trail of where it was, a
    solid line to where it would be in two minutes, and a dotted one on the heading that it is
    cleared to. Its planned route lies underneath.
    """

    def __init__(self, task: Any) -> None:
        if not isinstance(task, Visible):
            raise InputError(
                f"task {task.name} cannot be drawn (allowed: tasks with `sector` and `traffic`)"
            )
        self._task = task
        self._trail: list[Float[np.ndarray, "aircraft 2"]] = []
        with house_style():
            figure, (self._axes,) = grid_of_axes(1, 1, SIZE_IN)
            figure.set_dpi(PIXELS_PER_INCH)
            self._canvas = FigureCanvasAgg(figure)
            draw_sector(self._axes, task.sector)
            name_axes(self._axes)
            self._axes.set_title(f"{task.name}, minute 00:00")
            settle(figure)
            name_fixes(self._axes, task.sector)

    def clear(self) -> None:
        """A new scenario begins."""
        self._trail.clear()

    def sweep(self, state: TaskState) -> None:
        """Remember where everybody is after a cycle; where nobody has moved, none has passed."""
        position_nm = np.asarray(self._task.traffic(state).position_nm)
        if not self._trail or not np.array_equal(position_nm, self._trail[-1]):
            self._trail.append(position_nm)

    def picture(self, state: TaskState) -> UInt8[np.ndarray, "height width 3"]:
        """What is to be seen in a state of the scenario swept so far."""
        traffic = self._task.traffic(state)
        seconds = CYCLE_S * (len(self._trail) - 1)
        with house_style():
            self._axes.set_title(
                f"{self._task.name}, minute {seconds // 60:02d}:{seconds % 60:02d}"
            )
            lasting = set(self._axes.get_children())
            for number, callsign in enumerate(callsigns(len(traffic.level))):
                self._draw_way(traffic, number)
                if traffic.active[number]:
                    self._draw_aircraft(traffic, number, callsign)
            self._canvas.draw()  # type: ignore[no-untyped-call]
            for artist in set(self._axes.get_children()) - lasting:
                artist.remove()
        pixels = self._canvas.buffer_rgba()  # type: ignore[no-untyped-call]
        return np.array(pixels)[:, :, :3]

    def _draw_way(self, traffic: Traffic, number: int) -> None:
        """Where an aircraft is to go, and where it went."""
        sector, colour = self._task.sector, _colour(number)
        route = sector.routes[int(traffic.route[number])]
        planned = np.array([sector.fixes_nm[name] for name in route])
        self._axes.plot(*planned.T, color=colour, linewidth=7.0, alpha=0.13, zorder=2.5)
        trail = np.array(self._trail)[:, number]
        self._axes.plot(*trail.T, color=colour, linewidth=1.4, alpha=0.8, zorder=4)

    def _draw_aircraft(self, traffic: Traffic, number: int, callsign: str) -> None:
        colour, east_north = _colour(number), np.asarray(traffic.position_nm[number])
        ahead_nm = AHEAD_MIN / 60.0 * float(traffic.ground_speed_kt[number])
        heading, cleared = (
            np.radians(float(degrees[number]))
            for degrees in (traffic.heading_deg, traffic.cleared_heading_deg)
        )
        for angle, style in ((cleared, ":"), (heading, "-")):
            ahead = east_north + ahead_nm * np.array([np.sin(angle), np.cos(angle)])
            line = np.stack([east_north, ahead]).T
            self._axes.plot(*line, color=INK, linewidth=1.2, linestyle=style, zorder=5)
        self._axes.plot(*east_north, "s", color=colour, mec=PAPER, markersize=7.5, zorder=6)
        self._axes.annotate(
            f"{callsign}\n{_levels(traffic, number)}",
            (float(east_north[0]), float(east_north[1])),
            # To the right of the flight, off its lines.
            xytext=(LABEL_PT * np.cos(heading), -LABEL_PT * np.sin(heading)),
            textcoords="offset points",
            ha="left" if np.cos(heading) > 0.0 else "right",
            va="top" if np.sin(heading) > 0.0 else "bottom",
            color=colour,
            fontsize=9.0,
            fontweight="bold",
            path_effects=[withStroke(linewidth=2.2, foreground=PAPER)],
            zorder=8,
        )


def _colour(number: int) -> str:
    return SERIES[number % len(SERIES)]


def _levels(traffic: Traffic, number: int) -> str:
    """`FL300`, or with an arrow to the cleared level."""
    level, cleared = (
        round(float(values[number]) / TICKS_PER_FL)
        for values in (traffic.level, traffic.cleared_level)
    )
    return (
        f"FL{level:03d}"
        if level == cleared
        else f"FL{level:03d} \N{RIGHTWARDS ARROW} {cleared:03d}"
    )
