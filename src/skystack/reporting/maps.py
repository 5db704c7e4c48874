"""Maps of a sector: its area, airways and named fixes, and the routes through it."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from shapely import LineString, Polygon

from skystack.airspace.projection import geodesic_leg
from skystack.airspace.sector import Sector, turns_deg
from skystack.reporting.labels import Label, place_labels
from skystack.reporting.style import (
    AREA,
    FAINT,
    INK,
    LINES,
    MUTED,
    PAPER,
    SERIES,
    freeze_layout,
    grid_of_axes,
)

MARGIN_NM = 7.0
SCALE_BAR_NM = 20.0
BESIDE_NM = 2.2
"""The spacing of routes that share a leg, which are drawn side by side."""
DIMENSION_INSET_NM = 12.0
"""The distance of the width dimension from the end of its airway."""

Polyline = Float[np.ndarray, "_ 2"]


def sector_map(sector: Sector) -> Figure:
    """Draw the sector with its airways and fixes, a scale bar and the width of an airway."""
    figure, (axes,) = grid_of_axes(1, 1, (6.2, 6.0))
    lowest, highest = sector.levels_fl
    axes.set_title(f"{sector.name.title()} sector, FL{lowest:03d} to FL{highest:03d}")
    draw_sector(axes, sector, MUTED, LINES[3])
    ends = sorted({route[place] for route in sector.routes for place in (0, -1)})
    axes.plot(*_points(sector, ends).T, "^", color=INK, markersize=8.0, zorder=4)
    name_axes(axes)
    span = _draw_width(axes, sector)
    bar = _draw_scale(axes, sector)
    figure.legend(
        handles=[
            Line2D([], [], marker="^", ls="", color=INK, ms=8.0, label="first or last fix"),
            Line2D([], [], marker="^", ls="", mfc=PAPER, mec=MUTED, ms=7.0, label="fix"),
            Line2D([], [], color=MUTED, lw=1.0, ls=LINES[3], label="airway centreline"),
            Patch(facecolor=AREA, edgecolor=MUTED, label="sector"),
        ],
        loc="outside lower center",
        ncols=4,
    )
    freeze_layout(figure)
    labels = [
        Label(name, (float(at[0]), float(at[1])), INK, size_pt=9.5, weight="bold")
        for name, at in sector.fixes_nm.items()
    ]
    lines = [along(sector.path_nm(route)) for route in sector.routes]
    place_labels(axes, labels, np.concatenate([*lines, _outline(sector), span, bar]))
    return figure


def route_maps(sector: Sector) -> Figure:
    """Draw the routes through the sector, one panel for each first fix."""
    starts = list(dict.fromkeys(route[0] for route in sector.routes))
    columns = min(len(starts), 2)
    rows = -(-len(starts) // columns)
    figure, panels = grid_of_axes(rows, columns, (4.3 * columns, 4.6 * rows))
    drawn = []
    for axes, start in zip(panels, starts, strict=False):
        # Sorted from left to right, so that routes drawn side by side diverge without crossing.
        routes = sorted(
            (route for route in sector.routes if route[0] == start),
            key=lambda route: turns_deg(route, sector.fixes),
        )
        axes.set_title(f"From {start}")
        drawn += [*_draw_routes(axes, sector, routes), _draw_scale(axes, sector)]
        axes.legend(
            loc="upper left",
            bbox_to_anchor=(0.0, 0.0),
            handlelength=3.6,
            fontsize=7.5,
            labelcolor=INK,
        )
    for axes in panels:
        axes.set_axis_off()
    freeze_layout(figure)
    for axes, _ in zip(panels, starts, strict=False):
        # Names avoid the lines of all panels, so that all panels place them alike.
        name_fixes(axes, sector, drawn)
    return figure


def draw_sector(axes: Axes, sector: Sector, colour: str = FAINT, style: Any = "-") -> None:
    """Draw area, airway centrelines and fixes as the background, and set the axis limits."""
    axes.fill(*sector.area_nm.T, facecolor=AREA, edgecolor=colour, linewidth=0.8, zorder=1)
    legs = {tuple(sorted(leg)) for route in sector.routes for leg in pairwise(route)}
    for leg in sorted(legs):
        axes.plot(*sector.path_nm(leg).T, color=colour, linewidth=0.8, linestyle=style, zorder=2)
    fixes = np.array(list(sector.fixes_nm.values()))
    axes.plot(*fixes.T, "^", markersize=5.0, markerfacecolor=PAPER, markeredgecolor=MUTED, zorder=3)
    everything = np.concatenate([fixes, sector.area_nm])
    low, high = everything.min(axis=0) - MARGIN_NM, everything.max(axis=0) + MARGIN_NM
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")


def name_axes(axes: Axes) -> None:
    """Label the axes: distances in the Mercator plane, which are true at the origin."""
    axes.set_xlabel("NM east of the origin (scale at the origin)")
    axes.set_ylabel("NM north of the origin (scale at the origin)")


def along(path: Polyline, step_nm: float = 1.0) -> Polyline:
    """Points on a polyline, at most one step apart."""
    legs = [
        np.linspace(a, b, max(int(np.linalg.norm(b - a) / step_nm), 1), endpoint=False)
        for a, b in pairwise(path)
    ]
    return np.concatenate([*legs, path[-1:]])


def beside(path: Polyline, offset_nm: float) -> Polyline:
    """A polyline parallel to another, offset to its right, with mitred corners."""
    legs = np.diff(path, axis=0)
    units = legs / np.linalg.norm(legs, axis=1, keepdims=True)
    # Twice the direction at the ends, the sum of both directions at the corners.
    both = np.concatenate([units[:1], units]) + np.concatenate([units, units[-1:]])
    right = np.stack([both[:, 1], -both[:, 0]], axis=1)
    result: Polyline = path + offset_nm * 2.0 * right / np.sum(both**2, axis=1, keepdims=True)
    return result


def _points(sector: Sector, names: Sequence[str]) -> Polyline:
    return np.array([sector.fixes_nm[name] for name in names])


def _outline(sector: Sector) -> Polyline:
    return along(np.concatenate([sector.area_nm, sector.area_nm[:1]]))


def _draw_routes(axes: Axes, sector: Sector, routes: Sequence[tuple[str, ...]]) -> list[Polyline]:
    draw_sector(axes, sector)
    paths = []
    for number, route in enumerate(routes):
        offset_nm = BESIDE_NM * (number - (len(routes) - 1) / 2.0)
        path = beside(sector.path_nm(route), offset_nm)
        colour, style = SERIES[number % len(SERIES)], LINES[number % len(LINES)]
        label = " \N{EN DASH} ".join(route)
        axes.plot(*path.T, color=colour, linewidth=1.8, linestyle=style, zorder=4, label=label)
        east, north = path[-1] - path[-2]
        heading_deg = float(np.degrees(np.arctan2(east, north)))
        axes.plot(*path[-1], marker=(3, 0, -heading_deg), markersize=9.0, color=colour, zorder=5)
        paths.append(along(path))
    start = sector.fixes_nm[routes[0][0]]
    axes.plot(*start, "o", ms=9.0, markerfacecolor=PAPER, markeredgecolor=INK, mew=1.6, zorder=6)
    return paths


def name_fixes(axes: Axes, sector: Sector, lines: Sequence[Polyline] = ()) -> None:
    """Write the fixes' names clear of lines and marks, after `freeze_layout`."""
    labels = [
        Label(name, (float(at[0]), float(at[1])), INK, size_pt=7.5)
        for name, at in sector.fixes_nm.items()
    ]
    marks = np.array(list(sector.fixes_nm.values())).repeat(3, axis=0)
    place_labels(axes, labels, np.concatenate([*lines, marks]))


def _draw_width(axes: Axes, sector: Sector) -> Polyline:
    """Draw the width of the last airway of the first route that leaves the area, edge to edge.

    Draws nothing where that line would leave the area: there the exit edge is not an airway's end.
    """
    leaves = np.flatnonzero(~sector.route_table.lands)
    if not len(leaves):
        return np.empty((0, 2))
    right, left = sector.route_table.exit_ends_nm[leaves[0]].astype(np.float64)
    across = left - right
    width_nm = float(np.linalg.norm(across))
    _, true_nm = geodesic_leg(
        *map(tuple, sector.plane.to_degrees(np.stack([right, left])).tolist())
    )
    inward = np.array([-across[1], across[0]]) / width_nm * DIMENSION_INSET_NM
    ends = np.stack([right, left]) + inward
    if not _inside(sector, ends):
        return np.empty((0, 2))
    arrow = {"arrowstyle": "<->", "color": INK, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", ends[0], xytext=ends[1], arrowprops=arrow, zorder=5)
    upright_deg = (float(np.degrees(np.arctan2(across[1], across[0]))) + 90.0) % 180.0 - 90.0
    above = np.array([-np.sin(np.radians(upright_deg)), np.cos(np.radians(upright_deg))])
    # A quarter of the way across, clear of the centreline.
    east, north = ends[0] + 0.26 * across + 0.7 * above
    axes.text(
        east,
        north,
        f"{true_nm:.0f} NM",
        rotation=upright_deg,
        rotation_mode="anchor",
        ha="center",
        va="bottom",
        fontsize=8.5,
        zorder=6,
    )
    return along(ends)


def _inside(sector: Sector, ends: Polyline) -> bool:
    """Whether a line is inside the area, apart from its outermost hundredths."""
    inner = ends[0] + np.array([[0.01], [0.99]]) * (ends[1] - ends[0])
    return bool(Polygon(sector.area_nm).contains(LineString(inner)))


def _draw_scale(axes: Axes, sector: Sector) -> Polyline:
    """Draw a scale bar in the lower right corner; returns points that cover it."""
    north = axes.get_ylim()[0] + 3.0
    length = SCALE_BAR_NM * float(sector.plane.scale(np.array([north]))[0])
    east = axes.get_xlim()[1] - length - 3.0
    bar = np.array([[east, north], [east + length, north]])
    axes.plot(*bar.T, color=INK, linewidth=1.6, marker="|", markersize=6.0, zorder=5)
    axes.annotate(
        f"{SCALE_BAR_NM:.0f} NM",
        (east + length / 2.0, north),
        xytext=(0.0, 4.0),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=8.0,
        color=INK,
    )
    return np.concatenate([along(bar + above) for above in ([0.0, 0.0], [0.0, 3.0])])
