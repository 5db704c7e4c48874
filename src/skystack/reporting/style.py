"""The style of figures: colours that colour-blind readers can distinguish, fonts, formats."""

import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from skystack.io.files import atomic_write

INK, MUTED, FAINT = "#1b2026", "#5b6670", "#c3cad1"
AREA, PAPER = "#eef2f5", "#ffffff"
BLUE, VERMILION, GREEN, PURPLE = "#0072b2", "#d55e00", "#009e73", "#cc79a7"
ORANGE, SKY = "#e69f00", "#56b4e9"
SERIES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
"""The palette of Okabe and Ito."""
LINES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1)), (0, (6, 1.5, 1.5, 1.5)))
"""Dash patterns, which distinguish lines without colour."""

DARK_COLOURS = {
    INK: "#e8edf2",
    MUTED: "#9aa6b2",
    FAINT: "#46515c",
    AREA: "#202830",
    PAPER: "#161b20",
    BLUE: "#4aa8e0",
    VERMILION: "#ff8a3d",
    GREEN: "#2fc79a",
}
"""The replacements of colours on a dark page."""

PIXELS_PER_INCH = 200

_SETTINGS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.color": INK,
    "text.parse_math": False,  # a callsign may contain dollars
    "axes.edgecolor": MUTED,
    "axes.labelcolor": MUTED,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlepad": 9.0,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.facecolor": PAPER,
    "axes.facecolor": PAPER,
    "savefig.facecolor": PAPER,
    "svg.fonttype": "path",
    "svg.hashsalt": "skystack",  # equal figures give equal files
}


@contextmanager
def house_style() -> Iterator[None]:
    """A context with the style of figures; the caller's settings are restored afterwards."""
    with mpl.rc_context(), warnings.catch_warnings():
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        # Names may be in any script; glyphs missing from the font become boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        yield


def grid_of_axes(
    rows: int, columns: int, size_in: tuple[float, float], **shared: Any
) -> tuple[Figure, list[Axes]]:
    """A figure with a grid of axes, listed row by row, in a layout without overlaps."""
    figure = Figure(figsize=size_in, layout="constrained")
    FigureCanvasAgg(figure)  # without it, every measurement of a text creates a renderer
    grid = figure.subplots(rows, columns, squeeze=False, **shared)
    return figure, list(grid.flat)


def freeze_layout(figure: Figure) -> None:
    """Fix the layout, so that texts can be placed and saving does not lay out again."""
    if figure.get_layout_engine() is not None:
        figure.draw_without_rendering()
        figure.set_layout_engine(None)  # "none" leaves a placeholder: saving would draw twice


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write `<stem>.png` and `<stem>.svg`; equal figures give equal bytes."""
    paths = []
    for kind, data in (("png", as_png(figure)), ("svg", as_svg(figure).encode())):
        paths.append(stem.with_name(f"{stem.name}.{kind}"))
        atomic_write(paths[-1], data)
    return paths


def as_png(figure: Figure) -> bytes:
    """The figure as PNG; equal figures give equal bytes."""
    return _rendered(figure, "png")


def as_svg(figure: Figure) -> str:
    """The figure as SVG; equal figures give equal text."""
    return _shortened(_rendered(figure, "svg").decode())


def _rendered(figure: Figure, kind: str) -> bytes:
    freeze_layout(figure)
    plain: dict[str, Any] = {
        "png": {"dpi": PIXELS_PER_INCH, "metadata": {"Software": None}},
        "svg": {"metadata": {"Date": None, "Creator": None}},
    }
    data = io.BytesIO()
    # Cropped to what is drawn, since titles may extend beyond the layout. bbox_inches="tight" would
    # draw everything twice.
    box = figure.get_tightbbox().padded(0.12)
    figure.savefig(data, format=kind, bbox_inches=box, **plain[kind])
    return data.getvalue()


def _shortened(svg: str) -> str:
    """Shorten outlines to hundredths of a point, which halves the size."""
    return re.sub(
        r' d="[^"]*"', lambda outline: re.sub(r"(\.\d\d)\d+", r"\1", outline.group()), svg
    )


def with_dark_colours(svg: str) -> str:
    """Make the colours of a drawing follow the reader's light or dark colour scheme."""
    names = {light: f"--c{number}" for number, light in enumerate(DARK_COLOURS)}
    dark = "".join(f"{name}:{DARK_COLOURS[light]};" for light, name in names.items())
    sheet = f"<style>@media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}</style>"
    for light, name in names.items():
        svg = svg.replace(light, f"var({name},{light})")
    return re.sub(r"(<svg[^>]*>)", rf"\1{sheet}", svg, count=1)
