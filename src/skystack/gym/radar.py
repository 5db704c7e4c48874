"""The radar picture of a scenario as an array of pixels, without a display."""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg

from skystack.airspace.sector import Sector
from skystack.errors import InputError
from skystack.reporting.maps import draw_sector, name_axes, name_fixes
from skystack.reporting.radar import Blip, colour_of, draw_aircraft, draw_route_and_trail
from skystack.reporting.style import freeze_layout, grid_of_axes, house_style
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S
from skystack.simulator.traffic import Traffic, callsigns
from skystack.tasks.contract import TaskState

SIZE_IN, PIXELS_PER_INCH = (7.2, 6.8), 100


@runtime_checkable
class Visible(Protocol):
    """A task that can be drawn."""

    @property
    def name(self) -> str: ...

    @property
    def sector(self) -> Sector: ...

    def traffic(self, state: TaskState) -> Traffic: ...


class Radar:
    """Follows one scenario and draws it.

    Radars of one task can share a `screen`, the slowest part to create.
    """

    def __init__(self, task: Any, screen: "Screen | None" = None) -> None:
        self.screen = Screen(task) if screen is None else screen
        self._task = task
        self._trail: list[Float[np.ndarray, "aircraft 2"]] = []

    def clear(self) -> None:
        """Forget the trail, before a new scenario."""
        self._trail.clear()

    def sweep(self, state: TaskState) -> None:
        """Add the aircraft's positions to the trail if time has passed."""
        position_nm = np.asarray(self._task.traffic(state).position_nm)
        if not self._trail or not np.array_equal(position_nm, self._trail[-1]):
            self._trail.append(position_nm)

    def picture(self, state: TaskState) -> UInt8[np.ndarray, "height width 3"]:
        """The picture of a state, with the trail so far."""
        return self.screen.picture(self._task.traffic(state), self._trail)


class Screen:
    """The map of the sector, on which traffic is drawn.

    Each aircraft has a label with its callsign and its actual and cleared level, a trail of past
    positions, a solid line to its predicted position in two minutes, and a dotted line along its
    cleared heading. Its planned route is drawn underneath.
    """

    def __init__(self, task: Any) -> None:
        if not isinstance(task, Visible):
            raise InputError(
                f"task {task.name} cannot be drawn (allowed: tasks with `sector` and `traffic`)"
            )
        self._task = task
        with house_style():
            figure, (self._axes,) = grid_of_axes(1, 1, SIZE_IN)
            figure.set_dpi(PIXELS_PER_INCH)
            self._canvas = FigureCanvasAgg(figure)
            draw_sector(self._axes, task.sector)
            name_axes(self._axes)
            self._axes.set_title(f"{task.name}, time 00:00")
            freeze_layout(figure)
            name_fixes(self._axes, task.sector)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies draw the map again: a matplotlib figure cannot leave its process."""
        return type(self), (self._task,)

    def picture(
        self, traffic: Traffic, trail: Sequence[Float[np.ndarray, "aircraft 2"]]
    ) -> UInt8[np.ndarray, "height width 3"]:
        """The picture of traffic; `trail` holds the positions at the start and after each cycle."""
        seconds = CYCLE_S * (len(trail) - 1)
        with house_style():
            self._axes.set_title(f"{self._task.name}, time {seconds // 60:02d}:{seconds % 60:02d}")
            permanent = set(self._axes.get_children())
            for number, callsign in enumerate(callsigns(len(traffic.level_ticks))):
                sector, colour = self._task.sector, colour_of(number)
                route = sector.routes[int(traffic.route[number])]
                planned = sector.path_nm(route)
                draw_route_and_trail(self._axes, planned, np.array(trail)[:, number], colour)
                if traffic.active[number]:
                    blip = _blip(sector, traffic, number, callsign)
                    draw_aircraft(self._axes, blip, colour)
            self._canvas.draw()  # type: ignore[no-untyped-call]
            for artist in set(self._axes.get_children()) - permanent:
                artist.remove()
        pixels = self._canvas.buffer_rgba()  # type: ignore[no-untyped-call]
        return np.array(pixels)[:, :, :3]


def _blip(sector: Sector, traffic: Traffic, number: int, callsign: str) -> Blip:
    return Blip(
        callsign,
        np.asarray(traffic.position_nm[number]),
        heading_deg=float(traffic.heading_deg[number]),
        cleared_heading_deg=float(traffic.cleared_heading_deg[number]),
        ground_speed_kt=float(traffic.ground_speed_kt[number]),
        fl=float(traffic.level_ticks[number]) / TICKS_PER_FL,
        cleared_fl=float(traffic.cleared_level_ticks[number]) / TICKS_PER_FL,
        scale=float(sector.plane.scale(np.asarray(traffic.position_nm[number, 1:]))[0]),
    )
