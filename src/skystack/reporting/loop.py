"""A diagram of the loop of policy, online action-stacking and simulator."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from skystack.reporting.style import AREA, BLUE, INK, MUTED, grid_of_axes
from skystack.simulator.simulator import CYCLE_S

WIDTH, HEIGHT = 2.4, 0.9
"""The size of a box, in units of the axes."""

Point = tuple[float, float]
POLICY: Point = (1.4, 2.9)
STACKING: Point = (6.8, 2.9)
SIMULATOR: Point = (4.1, 0.6)


def loop() -> Figure:
    """Draw the control loop: boxes for the components, arrows for the data they pass on."""
    figure, (axes,) = grid_of_axes(1, 1, (6.4, 2.9))
    axes.set(xlim=(0.0, 8.2), ylim=(0.0, 3.5), aspect="equal")
    axes.set_axis_off()
    _box(axes, POLICY, "Policy", "the agent")
    _box(axes, STACKING, "Online\naction-stacking", "while the instruction repeats", BLUE)
    _box(axes, SIMULATOR, "Simulator", f"one radar cycle of {CYCLE_S:.0f} s")
    left, right = POLICY[0] + WIDTH / 2.0, STACKING[0] - WIDTH / 2.0
    middle = (left + right) / 2.0
    _arrow(axes, [(left, 3.1), (right, 3.1)])
    _label(axes, (middle, 3.22), "instruction", "bottom")
    _arrow(axes, [(right, 2.7), (left, 2.7)], BLUE)
    _label(axes, (middle, 2.58), "observation,\ntime frozen", "top", BLUE)
    below, side = POLICY[1] - HEIGHT / 2.0, WIDTH / 2.0
    _arrow(axes, [(STACKING[0], below), (STACKING[0], SIMULATOR[1]), (SIMULATOR[0] + side, 0.6)])
    _label(axes, ((STACKING[0] + SIMULATOR[0] + side) / 2.0, 0.48), "one clearance", "top")
    _arrow(axes, [(SIMULATOR[0] - side, 0.6), (POLICY[0], SIMULATOR[1]), (POLICY[0], below)])
    _label(axes, ((POLICY[0] + SIMULATOR[0] - side) / 2.0, 0.48), "observation,\nreward", "top")
    return figure


def _box(axes: Axes, centre: Point, title: str, subtitle: str, colour: str = INK) -> None:
    corner = (centre[0] - WIDTH / 2.0, centre[1] - HEIGHT / 2.0)
    shape = "round,pad=0,rounding_size=0.12"
    axes.add_patch(
        FancyBboxPatch(
            corner, WIDTH, HEIGHT, boxstyle=shape, facecolor=AREA, edgecolor=colour, linewidth=1.4
        )
    )
    axes.text(
        centre[0],
        centre[1] + 0.13,
        title,
        ha="center",
        va="center",
        color=colour,
        fontsize=9.5,
        fontweight="bold",
    )
    axes.text(
        centre[0], centre[1] - 0.28, subtitle, ha="center", va="center", color=MUTED, fontsize=7.0
    )


def _arrow(axes: Axes, path: list[Point], colour: str = INK) -> None:
    """Draw an arrow along a path, with its head at the end."""
    axes.plot(*zip(*path, strict=True), color=colour, linewidth=1.3, solid_joinstyle="round")
    head = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.3, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", path[-1], xytext=path[-2], arrowprops=head)


def _label(axes: Axes, at: Point, text: str, side: str, colour: str = INK) -> None:
    """Label an arrow with what it carries."""
    axes.text(*at, text, ha="center", va=side, color=colour, fontsize=8.5)
