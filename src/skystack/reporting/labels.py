"""Place texts next to points so that they hide neither each other nor the drawing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from skystack.reporting.style import MUTED, PAPER

POINTS_PER_INCH = 72.0
DIRECTIONS = 24
LEADER_FROM_PT = 12.0
"""A text farther from its point than this gets a leader line."""
PADDING_PT = 1.5

OUTSIDE_COST, LABEL_COST, DRAWN_COST, LEADER_COST, DISTANCE_COST = 400.0, 60.0, 4.0, 30.0, 0.25
"""The costs of being outside the axes, per text covered, per drawn point covered, per text that the
leader line crosses, and per pt of distance."""


@dataclass(frozen=True)
class Label:
    """A text and the point [data units] that it belongs to."""

    text: str
    point: tuple[float, float]
    colour: str
    size_pt: float = 7.5
    weight: str = "normal"
    distances_pt: tuple[float, ...] = (5.0, 9.0, 15.0, 23.0, 33.0, 45.0)
    """The distances from the point that are tried."""


def place_labels(axes: Axes, labels: Sequence[Label], drawn: Float[np.ndarray, "points 2"]) -> None:
    """Write each text at its cheapest position, in the order given.

    `drawn` samples what should stay visible (data units). The figure must be laid out, see
    `freeze_layout`.
    """
    scale = POINTS_PER_INCH / axes.figure.dpi
    frame = axes.get_window_extent()
    low, high = np.array(frame.min) * scale, np.array(frame.max) * scale
    obstacles = axes.transData.transform(drawn) * scale
    taken = np.zeros((0, 2, 2))
    for label in labels:
        text = axes.annotate(
            label.text,
            label.point,
            xytext=(0.0, 0.0),
            textcoords="offset points",
            ha="center",
            va="center",
            color=label.colour,
            fontsize=label.size_pt,
            fontweight=label.weight,
            path_effects=[withStroke(linewidth=2.2, foreground=PAPER)],
            zorder=8,
        )
        extent = text.get_window_extent()
        half = np.array([extent.width, extent.height]) * scale / 2.0 + PADDING_PT
        anchor = axes.transData.transform(label.point) * scale
        offsets = _offsets(half, label.distances_pt)
        centre = anchor + offsets
        boxes = np.stack([centre - half, centre + half], axis=1)
        gap = np.linalg.norm(np.maximum(np.abs(offsets) - half, 0.0), axis=1)
        cost = (
            OUTSIDE_COST * np.any((boxes[:, 0] < low) | (boxes[:, 1] > high), axis=1)
            + LABEL_COST * _overlapping(boxes, taken).sum(axis=1)
            + DRAWN_COST * _inside(obstacles, boxes).sum(axis=1)
            + LEADER_COST * _crossed(anchor, centre, taken)
            + DISTANCE_COST * gap
        )
        best = int(np.argmin(cost))
        text.set_position(tuple(offsets[best]))
        taken = np.concatenate([taken, boxes[best : best + 1]])
        if gap[best] > LEADER_FROM_PT:
            _leader(axes, label, offsets[best], half)


def _offsets(
    half: Float[np.ndarray, "2"], distances: Sequence[float]
) -> Float[np.ndarray, "candidates 2"]:
    """Centres of a box at each distance from the point, in all directions."""
    angle = np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    square = circle / np.abs(circle).max(axis=1, keepdims=True)
    return np.concatenate([square * (half + distance) for distance in distances])


def _overlapping(
    boxes: Float[np.ndarray, "n 2 2"], others: Float[np.ndarray, "m 2 2"]
) -> Bool[np.ndarray, "n m"]:
    apart = (boxes[:, None, 0] > others[None, :, 1]) | (boxes[:, None, 1] < others[None, :, 0])
    return ~np.any(apart, axis=-1)


def _inside(
    points: Float[np.ndarray, "m 2"], boxes: Float[np.ndarray, "n 2 2"]
) -> Bool[np.ndarray, "n m"]:
    x, y = points.T
    left, bottom = boxes[:, 0].T[:, :, None]
    right, top = boxes[:, 1].T[:, :, None]
    return (x > left) & (x < right) & (y > bottom) & (y < top)


def _crossed(
    anchor: Float[np.ndarray, "2"],
    centres: Float[np.ndarray, "n 2"],
    taken: Float[np.ndarray, "m 2 2"],
) -> Float[np.ndarray, " n"]:
    """The number of texts between the point and each candidate position."""
    along = np.linspace(0.0, 1.0, 9)[:, None, None]
    line = anchor + along * (centres - anchor)
    hit = _inside(line.reshape(-1, 2), taken).reshape(len(taken), *line.shape[:2])
    return hit.any(axis=1).sum(axis=0).astype(float)


def _leader(
    axes: Axes, label: Label, offset: Float[np.ndarray, "2"], half: Float[np.ndarray, "2"]
) -> None:
    """Draw a thin line from the point to the nearest place on the text's box."""
    end = np.clip(np.zeros(2), offset - half, offset + half)
    axes.annotate(
        "",
        label.point,
        xytext=tuple(end),
        textcoords="offset points",
        arrowprops={
            "arrowstyle": "-",
            "color": MUTED,
            "linewidth": 0.5,
            "shrinkA": 0.0,
            "shrinkB": 2.5,
        },
        zorder=7,
    )
