"""Drawing of aircraft on a radar, shared by films, stills and rendered environments.

The symbols are those of the replay page: a square, filled and crossed if separation is lost.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke

from skystack.airspace.sector import Sector
from skystack.reporting.style import INK, PAPER, SERIES

AHEAD_MIN = 2.0
"""The length of the heading line, in minutes of flight."""
LABEL_PT = 9.0
"""The distance between an aircraft and its label."""


ROUTE: dict[str, Any] = {"linewidth": 7.0, "alpha": 0.13, "zorder": 2.5}
TRAIL: dict[str, Any] = {"linewidth": 1.4, "alpha": 0.8, "zorder": 4}
AHEAD: dict[str, Any] = {"color": INK, "linewidth": 1.2, "zorder": 8.5}
RING: dict[str, Any] = {"lw": 2.2, "zorder": 8.5}
SQUARE: dict[str, Any] = {"marker": "s", "linewidths": 1.6, "zorder": 9}
SQUARE_PT, LOSS_PT = 6.0, 9.0
"""The size of the symbol, usually and in a loss of separation."""
CROSS: dict[str, Any] = {"marker": "x", "linewidths": 1.4, "zorder": 9.5}
CROSS_PT = 6.0
DASHED = (0, (3, 2.5))
"""The line on the cleared heading."""
SCALE_BARS_NM = (100, 50, 20, 10, 5, 2, 1)
LABEL: dict[str, Any] = {"fontsize": 9.0, "fontweight": "bold"}
HALO = withStroke(linewidth=2.2, foreground=PAPER)


class Blip(NamedTuple):
    """The state of an aircraft as drawn on the radar."""

    callsign: str
    position_nm: Float[np.ndarray, "2"]
    heading_deg: float
    cleared_heading_deg: float
    ground_speed_kt: float
    fl: float
    cleared_fl: float
    scale: float = 1.0
    """The local scale of the plane: plane length per true length."""


def colour_of(number: int) -> str:
    """The colour of an aircraft, by its index in the scenario."""
    return SERIES[number % len(SERIES)]


def draw_route_and_trail(
    axes: Axes,
    route_nm: Float[np.ndarray, "points 2"],
    trail_nm: Float[np.ndarray, "rows 2"],
    colour: str,
) -> None:
    """Draw the route and the trail of an aircraft."""
    draw_route(axes, route_nm, colour)
    draw_trail(axes, trail_nm, colour)


def draw_trail(axes: Axes, trail_nm: Float[np.ndarray, "rows 2"], colour: str) -> None:
    """Draw the past positions of an aircraft."""
    axes.plot(*trail_nm.T, color=colour, **TRAIL)


def draw_route(axes: Axes, route_nm: Float[np.ndarray, "points 2"], colour: str) -> None:
    """Draw the route of an aircraft."""
    axes.plot(*route_nm.T, color=colour, **ROUTE)


def draw_aircraft(axes: Axes, blip: Blip, colour: str, ring_nm: float = 0.0) -> None:
    """Draw an aircraft as a square with its callsign and level.

    A solid line ends at its position in two minutes. A dashed line of the same length shows the
    cleared heading. With `ring_nm`, separation is lost: the square is filled and crossed, and a
    ring of that true radius is drawn.
    """
    here = (float(blip.position_nm[0]), float(blip.position_nm[1]))
    for line, style in zip(lines_ahead(blip), (DASHED, "-"), strict=True):
        axes.plot(*line.T, linestyle=style, **AHEAD)
    if ring_nm:
        axes.scatter(*here, s=LOSS_PT**2, facecolors=colour, edgecolors=colour, **SQUARE)
        axes.scatter(*here, s=CROSS_PT**2, c=PAPER, **CROSS)
        axes.add_patch(Circle(here, ring_nm * blip.scale, fill=False, ec=colour, **RING))
    else:
        axes.scatter(*here, s=SQUARE_PT**2, facecolors=PAPER, edgecolors=colour, **SQUARE)
    label = place_of_label(blip)
    axes.annotate(
        label.text,
        here,
        xytext=label.offset_pt,
        textcoords="offset points",
        ha=label.ha,
        va=label.va,
        color=colour,
        path_effects=[HALO],
        zorder=10,  # above the names of fixes
        **LABEL,
    )


def draw_scale_bar(axes: Axes, sector: Sector) -> None:
    """Draw a bar of a round number of NM at the lower left, true in the middle of the map."""
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    scale = float(sector.plane.scale(np.array([(south + north) / 2.0]))[0])
    width = east - west
    nm = next((each for each in SCALE_BARS_NM if each * scale <= width / 4.0), SCALE_BARS_NM[-1])
    start, level = west + 0.02 * width, south + 0.02 * (north - south)
    end = start + nm * scale
    axes.plot([start, end], [level, level], color=INK, lw=1.2, marker="|", ms=6.0, zorder=5)
    axes.annotate(
        f"{nm} NM",
        (end, level),
        xytext=(6.0, 0.0),
        textcoords="offset points",
        va="center",
        fontsize=8.0,
        color=INK,
    )


def lines_ahead(blip: Blip) -> tuple[Float[np.ndarray, "2 2"], Float[np.ndarray, "2 2"]]:
    """Lines of two minutes' flight on the cleared heading and on the actual heading."""
    here = blip.position_nm
    ahead_nm = AHEAD_MIN / 60.0 * blip.ground_speed_kt * blip.scale
    cleared, own = (
        np.stack([here, here + ahead_nm * np.array([np.sin(angle), np.cos(angle)])])
        for angle in np.radians([blip.cleared_heading_deg, blip.heading_deg])
    )
    return cleared, own


class LabelPlace(NamedTuple):
    """The two lines of an aircraft's label, and their placement."""

    text: str
    offset_pt: tuple[float, float]
    ha: str
    va: str


def place_of_label(blip: Blip) -> LabelPlace:
    """Place the label to the right of the flight direction, clear of the heading lines."""
    heading = np.radians(blip.heading_deg)
    return LabelPlace(
        f"{blip.callsign}\n{levels_of(blip)}",
        (float(LABEL_PT * np.cos(heading)), float(-LABEL_PT * np.sin(heading))),
        ha="left" if np.cos(heading) > 0.0 else "right",
        va="top" if np.sin(heading) > 0.0 else "bottom",
    )


def levels_of(blip: Blip) -> str:
    """The level as `FL300`, with an arrow and the cleared level if that differs."""
    level, cleared = round(blip.fl), round(blip.cleared_fl)
    if level == cleared:
        return f"FL{level:03d}"
    return f"FL{level:03d} \N{RIGHTWARDS ARROW} {cleared:03d}"
