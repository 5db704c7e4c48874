"""What a radar picture shows of an aircraft; shared by films, stills and rendered environments."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke

from skystack.reporting.style import INK, PAPER, SERIES

AHEAD_MIN = 2.0
"""How far ahead of an aircraft its heading line shows it."""
LABEL_PT = 9.0
"""How far from an aircraft its label stands."""


class Blip(NamedTuple):
    """An aircraft as radar and flight plan show it."""

    callsign: str
    position_nm: Float[np.ndarray, "2"]
    heading_deg: float
    cleared_heading_deg: float
    ground_speed_kt: float
    fl: float
    cleared_fl: float
    scale: float = 1.0
    """Of the plane there: what a true length is multiplied by."""


def colour_of(number: int) -> str:
    """Of an aircraft, by its place in the scenario."""
    return SERIES[number % len(SERIES)]


def draw_way(
    axes: Axes,
    route_nm: Float[np.ndarray, "points 2"],
    trail_nm: Float[np.ndarray, "rows 2"],
    colour: str,
) -> None:
    """Where an aircraft is to go, and where it went."""
    axes.plot(*route_nm.T, color=colour, linewidth=7.0, alpha=0.13, zorder=2.5)
    axes.plot(*trail_nm.T, color=colour, linewidth=1.4, alpha=0.8, zorder=4)


def draw_aircraft(axes: Axes, blip: Blip, colour: str, ring_nm: float = 0.0) -> None:
    """A square, its callsign with its level, a solid line to where it would be in two minutes, a
    dotted one on the heading that it is cleared to; and a ring of the true radius, if one is given.
    """
    here = blip.position_nm
    ahead_nm = AHEAD_MIN / 60.0 * blip.ground_speed_kt * blip.scale
    heading, cleared = np.radians(blip.heading_deg), np.radians(blip.cleared_heading_deg)
    for angle, style in ((cleared, ":"), (heading, "-")):
        ahead = here + ahead_nm * np.array([np.sin(angle), np.cos(angle)])
        axes.plot(*np.stack([here, ahead]).T, color=INK, linewidth=1.2, linestyle=style, zorder=8.5)
    axes.plot(*here, "s", color=colour, mec=PAPER, markersize=7.5, zorder=9)
    if ring_nm:
        centre = (float(here[0]), float(here[1]))
        axes.add_patch(
            Circle(
                centre, ring_nm * blip.scale, fill=False, ec=colour, lw=0.9, alpha=0.7, zorder=8.5
            )
        )
    axes.annotate(
        f"{blip.callsign}\n{levels_of(blip)}",
        (float(here[0]), float(here[1])),
        # To the right of the flight, off its lines.
        xytext=(LABEL_PT * np.cos(heading), -LABEL_PT * np.sin(heading)),
        textcoords="offset points",
        ha="left" if np.cos(heading) > 0.0 else "right",
        va="top" if np.sin(heading) > 0.0 else "bottom",
        color=colour,
        fontsize=9.0,
        fontweight="bold",
        path_effects=[withStroke(linewidth=2.2, foreground=PAPER)],
        zorder=10,  # above the names of fixes
    )


def levels_of(blip: Blip) -> str:
    """`FL300`, or with an arrow to the cleared level."""
    level, cleared = round(blip.fl), round(blip.cleared_fl)
    if level == cleared:
        return f"FL{level:03d}"
    return f"FL{level:03d} \N{RIGHTWARDS ARROW} {cleared:03d}"
