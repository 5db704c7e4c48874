"""The frames of a film: the background is drawn once, moving parts with few draw calls.

The lines and marks of all aircraft are drawn together, and each label is rendered once and then
pasted. Drawn one by one, as in a still, 200 aircraft would take seconds per frame.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
from matplotlib.collections import EllipseCollection, LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.text import Text

from skystack.reporting.radar import (
    AHEAD,
    CROSS,
    CROSS_PT,
    DASHED,
    HALO,
    LABEL,
    LOSS_PT,
    RING,
    SQUARE,
    SQUARE_PT,
    TRAIL,
    Blip,
    lines_ahead,
    place_of_label,
)
from skystack.reporting.style import PAPER

Picture = UInt8[np.ndarray, "height width 4"]


class Sprite(NamedTuple):
    """A text as RGBA pixels, lowest row first."""

    pixels: Picture
    left: int
    """The offset from the text's position, like `bottom`."""
    bottom: int


class Texts:
    """A cache of rendered texts with halos."""

    WIDTH, HEIGHT = 1200, 120

    def __init__(self, dots_per_inch: float) -> None:
        size_in = self.WIDTH / dots_per_inch, self.HEIGHT / dots_per_inch
        self._figure = Figure(figsize=size_in, dpi=dots_per_inch)
        self._canvas = FigureCanvasAgg(self._figure)
        self._known: dict[tuple[str, str, str, str], Sprite] = {}

    def sprite(self, text: str, colour: str, ha: str, va: str) -> Sprite:
        """The pixels of a text with the given alignment."""
        key = (text, colour, ha, va)
        if key not in self._known:
            self._known[key] = self._rendered(*key)
        return self._known[key]

    def _rendered(self, text: str, colour: str, ha: str, va: str) -> Sprite:
        renderer = self._canvas.get_renderer()  # type: ignore[no-untyped-call]
        renderer.clear()
        x, y = self.WIDTH // 2, self.HEIGHT // 2
        artist = Text(x, y, text, color=colour, ha=ha, va=va, **LABEL)
        artist.set_path_effects([HALO])
        artist.set_figure(self._figure)
        artist.draw(renderer)
        pixels = lowest_row_first(renderer)
        rows, columns = (np.flatnonzero(pixels[..., 3].any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return Sprite(pixels[:0], 0, 0)
        bottom, left = int(rows[0]), int(columns[0])
        cut = np.ascontiguousarray(pixels[bottom : rows[-1] + 1, left : columns[-1] + 1])
        return Sprite(cut, left - x, bottom - y)


def lowest_row_first(renderer: RendererAgg) -> Picture:
    """The rendered pixels in the row order that `draw_image` expects."""
    pixels = np.asarray(renderer.buffer_rgba())  # type: ignore[no-untyped-call]
    return np.ascontiguousarray(pixels[::-1])


class TrafficPicture:
    """The aircraft of a panel: their trails, lines, rings, marks and labels."""

    def __init__(self, axes: Axes, colours: Sequence[str], texts: Texts) -> None:
        self._axes, self._texts = axes, texts
        self._trails = LineCollection([], colors=colours, **TRAIL)
        self._trails.set(capstyle="projecting", joinstyle="round")
        self._ahead = [LineCollection([], linestyles=style, **AHEAD) for style in (DASHED, "-")]
        self._squares: PathCollection = axes.scatter([], [], **SQUARE)
        self._crosses: PathCollection = axes.scatter([], [], s=CROSS_PT**2, c=PAPER, **CROSS)
        for lines in (self._trails, *self._ahead):
            axes.add_collection(lines, autolim=False)
        for artist in (self._trails, *self._ahead, self._squares, self._crosses):
            artist.set_animated(True)

    def draw_trails(self, trails_nm: Sequence[Float[np.ndarray, "_ 2"]]) -> None:
        self._trails.set_segments(list(trails_nm))
        self._axes.draw_artist(self._trails)

    def draw_aircraft(
        self, blips: Sequence[Blip], colours: Sequence[str], rings_nm: Sequence[float]
    ) -> None:
        """Draw the visible aircraft. A ring, unless its radius is 0, marks a loss of separation."""
        if not blips:
            return
        place = np.array([blip.position_nm for blip in blips])
        both = zip(*(lines_ahead(blip) for blip in blips), strict=True)
        for lines, segments in zip(self._ahead, both, strict=True):
            lines.set_segments(list(segments))
            self._axes.draw_artist(lines)
        self._draw_rings(blips, colours, rings_nm)
        self._draw_symbols(colours, rings_nm, place)
        self._draw_labels(blips, colours, place)

    def _draw_symbols(
        self,
        colours: Sequence[str],
        rings_nm: Sequence[float],
        place: Float[np.ndarray, "blips 2"],
    ) -> None:
        lost = np.array(rings_nm) > 0.0
        self._squares.set_offsets(place)
        self._squares.set_sizes(np.where(lost, LOSS_PT, SQUARE_PT) ** 2)
        self._squares.set_facecolor(
            [colour if filled else PAPER for colour, filled in zip(colours, lost, strict=True)]
        )
        self._squares.set_edgecolor(list(colours))
        self._axes.draw_artist(self._squares)
        self._crosses.set_offsets(place[lost])
        self._axes.draw_artist(self._crosses)

    def _draw_rings(
        self, blips: Sequence[Blip], colours: Sequence[str], rings_nm: Sequence[float]
    ) -> None:
        found = [number for number, ring_nm in enumerate(rings_nm) if ring_nm]
        if not found:
            return
        across = [2.0 * rings_nm[number] * blips[number].scale for number in found]
        rings = EllipseCollection(
            across,
            across,
            np.zeros(len(found)),
            units="xy",
            offsets=[blips[number].position_nm for number in found],
            offset_transform=self._axes.transData,
            facecolors="none",
            edgecolors=[colours[number] for number in found],
            **RING,
        )
        self._axes.add_collection(rings, autolim=False)
        self._axes.draw_artist(rings)
        rings.remove()

    def _draw_labels(
        self, blips: Sequence[Blip], colours: Sequence[str], place: Float[np.ndarray, "blips 2"]
    ) -> None:
        renderer: Any = self._axes.figure.canvas.get_renderer()  # type: ignore[attr-defined]
        context = renderer.new_gc()
        at = self._axes.transData.transform(place)
        seen = self._axes.bbox
        for blip, colour, (x, y) in zip(blips, colours, at, strict=True):
            if not seen.contains(x, y):
                continue
            label = place_of_label(blip)
            points = renderer.points_to_pixels(1.0)
            left, bottom = x + points * label.offset_pt[0], y + points * label.offset_pt[1]
            # Line by line, since lines with levels change often and are shared between aircraft.
            first, second = label.text.split("\n")
            for text in (f"{first}\n ", f" \n{second}"):
                sprite = self._texts.sprite(text, colour, label.ha, label.va)
                if len(sprite.pixels):
                    at_pixel = round(left) + sprite.left, round(bottom) + sprite.bottom
                    renderer.draw_image(context, *at_pixel, sprite.pixels)
