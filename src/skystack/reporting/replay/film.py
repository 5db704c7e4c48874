"""Stills and films of a replay as PNG, SVG, GIF and MP4, drawn without a display.

They show one replay, or two of the same scenario side by side and in step. They are for papers,
slides and READMEs; the page (`page.py`) shows more.
"""

import io
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text
from PIL import Image

from skystack.airspace.sector import Sector
from skystack.errors import InputError
from skystack.evaluation.losses import Loss
from skystack.io.files import atomic_write, check_output
from skystack.reporting.maps import draw_sector, name_fixes
from skystack.reporting.radar import (
    Blip,
    colour_of,
    draw_aircraft,
    draw_route,
    draw_scale_bar,
    draw_trail,
)
from skystack.reporting.replay.frames import Picture, Texts, TrafficPicture, lowest_row_first
from skystack.reporting.replay.recording import RecordedAircraft, Replay, ReplayScenario
from skystack.reporting.replay.side_by_side import read_side_by_side
from skystack.reporting.replay.video import as_mp4, find_ffmpeg
from skystack.reporting.style import (
    MUTED,
    VERMILION,
    as_png,
    as_svg,
    freeze_layout,
    grid_of_axes,
    house_style,
)
from skystack.simulator.simulator import CYCLE_S

PANEL_IN, PIXELS_PER_INCH = (5.2, 5.6), 84
FRAMES_PER_S = 10
LAST_FRAME_MS = 2500
LATEST = 3
"""The number of latest clearances that are written below the picture."""
MAX_PAIRS = 2
"""The number of pairs in a loss of separation that are named."""
SHORT_TRAIL = 20
"""The length of trails in arriving traffic, in cycles."""
MAX_FRAMES = 2000
"""The maximum number of frames of a film. All are in memory while it is written."""


SUFFIXES = (".png", ".svg", ".gif", ".mp4")


class Span(NamedTuple):
    """The part of a scenario that is drawn: its first and its last row."""

    begin: int
    end: int


def span_of(replays: tuple[Replay, ...], number: int, from_s: int, to_s: int | None) -> Span:
    """The rows between two times. Raises InputError for a missing scenario or invalid times."""
    scenarios = [_scenario(replay, number) for replay in replays]
    last = max(scenario.cycles for scenario in scenarios)
    end = last if to_s is None else to_s // CYCLE_S
    if not (0 <= from_s <= last * CYCLE_S and from_s // CYCLE_S <= end <= last):
        raise InputError(
            f"--from {from_s} --to {end * CYCLE_S if to_s is None else to_s} (allowed: times from "
            f"0 to {last * CYCLE_S} s, the earlier one first)"
        )
    return Span(from_s // CYCLE_S, end)


def write_picture(
    runs: Sequence[Path],
    output: Path,
    number: int,
    from_s: int = 0,
    to_s: int | None = None,
    on_frame: Callable[[int], None] = lambda row: None,
) -> dict[str, Any]:
    """Write a still or a film of a scenario; `runs` as for `read_replay`.

    Returns `output`, `bytes`, `runs` (their titles), `from_s` and `to_s`. Raises InputError as
    `read_side_by_side` and `span_of` do, before anything is written. A film as .mp4 needs ffmpeg.
    """
    check_output(output, *runs)
    ffmpeg = find_ffmpeg() if output.suffix == ".mp4" else None
    replays = read_side_by_side(runs, only=number)
    span = span_of(replays, number, from_s, to_s)
    kind = output.suffix[1:]
    if ffmpeg is not None:
        data = video(replays, number, span, ffmpeg, on_frame)
    elif kind == "gif":
        data = film(replays, number, span, on_frame)
    else:
        data = still(replays, number, span, kind)
    atomic_write(output, data)
    return {
        "output": str(output),
        "bytes": len(data),
        "runs": [replay.title for replay in replays],
        "from_s": span.begin * CYCLE_S,
        "to_s": span.end * CYCLE_S,
    }


def still(replays: tuple[Replay, ...], number: int, span: Span, kind: str) -> bytes:
    """The picture at the end of the span, with trails from its start; `kind` is png or svg."""
    with house_style():
        scene = _Scene(replays, number, span)
        scene.draw(span.end)
        return as_png(scene.figure) if kind == "png" else as_svg(scene.figure).encode()


def film(
    replays: tuple[Replay, ...],
    number: int,
    span: Span,
    on_frame: Callable[[int], None] = lambda row: None,
) -> bytes:
    """An animated GIF: one radar cycle per frame, ten frames per second, 60 times real time."""
    rows = _rows_of_film(span)
    with house_style():
        scene = _FilmScene(replays, number, span)
        # One palette for all frames, so that no colour flickers; the last frame shows everything.
        palette = scene.pixels(span.end).quantize(64, dither=Image.Dither.NONE)
        frames = []
        for row in rows:
            frame = scene.pixels(row)
            frames.append(frame.quantize(palette=palette, dither=Image.Dither.NONE))
            on_frame(row)
    data = io.BytesIO()
    durations = [1000 // FRAMES_PER_S] * (len(frames) - 1) + [LAST_FRAME_MS]
    frames[0].save(
        data,
        "GIF",
        save_all=True,
        append_images=frames[1:],
        duration=durations,
        loop=0,
        optimize=True,
    )
    return data.getvalue()


def video(
    replays: tuple[Replay, ...],
    number: int,
    span: Span,
    ffmpeg: str,
    on_frame: Callable[[int], None] = lambda row: None,
) -> bytes:
    """The same film as MP4, in full colour; `ffmpeg` is the path of the program."""
    rows = _rows_of_film(span)

    def frames() -> Iterator[Image.Image]:
        scene = _FilmScene(replays, number, span)
        for row in rows:
            frame = scene.pixels(row)
            yield frame
            on_frame(row)
        for _ in range(LAST_FRAME_MS * FRAMES_PER_S // 1000 - 1):
            yield frame

    with house_style():
        return as_mp4(frames(), FRAMES_PER_S, ffmpeg)


def _rows_of_film(span: Span) -> range:
    """The rows of a film, one per frame. Raises InputError if there are too many."""
    rows = range(span.begin, span.end + 1)
    if len(rows) > MAX_FRAMES:
        raise InputError(
            f"a film of {len(rows)} cycles (allowed: {MAX_FRAMES}; --from and --to select a part)"
        )
    return rows


class _Scene:
    """The figure, with one panel per replay."""

    def __init__(self, replays: tuple[Replay, ...], number: int, span: Span) -> None:
        width, height = PANEL_IN
        self.figure, self._panels = grid_of_axes(1, len(replays), (width * len(replays), height))
        self.figure.set_dpi(PIXELS_PER_INCH)
        self._canvas = FigureCanvasAgg(self.figure)
        self._replays, self._span = replays, span
        self._scenarios = [_scenario(replay, number) for replay in replays]
        for axes, replay in zip(self._panels, replays, strict=True):
            draw_sector(axes, replay.sector)
            draw_scale_bar(axes, replay.sector)
            axes.set_axis_off()
            axes.set_title(f"{replay.title}\n ")
            # Room for the clearances.
            axes.text(0.0, -0.02, "\n" * LATEST, transform=axes.transAxes, va="top", fontsize=9.0)
        freeze_layout(self.figure)
        self._fix_names = list[tuple[Axes, Artist]]()
        for axes, replay in zip(self._panels, replays, strict=True):
            before = set(axes.get_children())
            name_fixes(axes, replay.sector)
            new = (artist for artist in axes.get_children() if artist not in before)
            self._fix_names += [(axes, artist) for artist in new]

    @property
    def _contents(self) -> Iterator[tuple[Axes, Replay, ReplayScenario]]:
        return zip(self._panels, self._replays, self._scenarios, strict=True)

    def draw(self, row: int) -> None:
        """Draw the state after a number of cycles."""
        for axes, replay, scenario in self._contents:
            axes.set_title(_title(replay, scenario, row))
            lost = _in_loss(scenario, row)
            for number, flown in enumerate(scenario.aircraft):
                colour = colour_of(number)
                if not scenario.has_arrivals:
                    draw_route(axes, replay.sector.path_nm(flown.route), colour)
                draw_trail(axes, _trail(scenario, number, self._span.begin, row), colour)
                if flown.flies_at(row):
                    colour = VERMILION if number in lost else colour
                    ring_nm = replay.sector.separation_nm if number in lost else 0.0
                    draw_aircraft(axes, _blip(replay.sector, flown, row), colour, ring_nm)
            _write_clearances(axes, scenario, row)
            _write_losses(axes, scenario, row)


class _FilmScene(_Scene):
    """The figure of a film, whose static background is drawn once."""

    def __init__(self, replays: tuple[Replay, ...], number: int, span: Span) -> None:
        super().__init__(replays, number, span)
        texts = Texts(PIXELS_PER_INCH)
        self._traffic = []
        for axes, replay, scenario in self._contents:
            colours = [colour_of(aircraft) for aircraft in range(len(scenario.aircraft))]
            routes = (flown.route for flown in scenario.aircraft)
            for route, colour in dict.fromkeys(zip(routes, colours, strict=True)):
                if not scenario.has_arrivals:
                    draw_route(axes, replay.sector.path_nm(route), colour)
            self._traffic.append(TrafficPicture(axes, colours, texts))
            axes.set_title("").set_animated(True)
        for _, artist in self._fix_names:
            artist.set_animated(True)
        self._canvas.draw()  # type: ignore[no-untyped-call]
        self._background = self._canvas.copy_from_bbox(self.figure.bbox)  # type: ignore[no-untyped-call]
        self._names_layer = self._draw_fix_names()

    def _draw_fix_names(self) -> Picture:
        renderer = self._canvas.get_renderer()  # type: ignore[no-untyped-call]
        renderer.clear()
        for axes, artist in self._fix_names:
            axes.draw_artist(artist)
        return lowest_row_first(renderer)

    def pixels(self, row: int) -> Image.Image:
        """Render one frame."""
        renderer = self._canvas.get_renderer()  # type: ignore[no-untyped-call]
        self._canvas.restore_region(self._background)  # type: ignore[no-untyped-call]
        for traffic, (_, _, scenario) in zip(self._traffic, self._contents, strict=True):
            begin = self._span.begin
            traffic.draw_trails(
                [_trail(scenario, n, begin, row) for n in range(len(scenario.aircraft))]
            )
        renderer.draw_image(renderer.new_gc(), 0, 0, self._names_layer)
        for traffic, (axes, replay, scenario) in zip(self._traffic, self._contents, strict=True):
            lost = _in_loss(scenario, row)
            flying = [n for n, flown in enumerate(scenario.aircraft) if flown.flies_at(row)]
            traffic.draw_aircraft(
                [_blip(replay.sector, scenario.aircraft[number], row) for number in flying],
                [VERMILION if number in lost else colour_of(number) for number in flying],
                [replay.sector.separation_nm if number in lost else 0.0 for number in flying],
            )
            axes.draw_artist(axes.set_title(_title(replay, scenario, row)))
            for text in (
                *_write_clearances(axes, scenario, row),
                *_write_losses(axes, scenario, row),
            ):
                axes.draw_artist(text)
                text.remove()
        return Image.fromarray(np.asarray(self._canvas.buffer_rgba())[:, :, :3])  # type: ignore[no-untyped-call]


def _title(replay: Replay, scenario: ReplayScenario, row: int) -> str:
    issued = sum(each.cycle < row for each in scenario.transmissions)
    minutes, seconds = divmod(row * CYCLE_S, 60)
    count = f"{issued} clearance{'' if issued == 1 else 's'}"
    return f"{replay.title}\n{count}, time {minutes:02d}:{seconds:02d}"


def _losses_in(scenario: ReplayScenario, row: int) -> list[Loss]:
    """The losses of separation in the cycle that ends at a row."""
    return [loss for loss in scenario.losses if loss.begins < row <= loss.ends]


def _in_loss(scenario: ReplayScenario, row: int) -> set[int]:
    """The indices of the aircraft that have lost separation."""
    return {number for loss in _losses_in(scenario, row) for number in (loss.first, loss.second)}


def _write_losses(axes: Axes, scenario: ReplayScenario, row: int) -> list[Text]:
    """Name the pairs that have lost separation, at the top of the panel."""
    pairs = [
        " and ".join(scenario.aircraft[number].callsign for number in (loss.first, loss.second))
        for loss in _losses_in(scenario, row)
    ]
    if not pairs:
        return []
    more = f" and {len(pairs) - MAX_PAIRS} more pairs" if len(pairs) > MAX_PAIRS else ""
    text = f"loss of separation: {'; '.join(pairs[:MAX_PAIRS])}{more}"
    return [
        axes.text(
            0.0,
            1.0,
            text,
            transform=axes.transAxes,
            va="top",
            fontsize=9.0,
            fontweight="bold",
            color=VERMILION,
            zorder=11,
        )
    ]


def _write_clearances(axes: Axes, scenario: ReplayScenario, row: int) -> list[Text]:
    """Write the last clearances below the panel, the latest first."""
    issued = [each for each in scenario.transmissions if each.cycle < row]
    texts = []
    for line, each in enumerate(issued[: -LATEST - 1 : -1]):
        recent = row - each.cycle <= 5
        stacked = f" ({each.instructions} instructions)" if each.instructions > 1 else ""
        texts.append(
            axes.text(
                0.0,
                -0.02 - 0.045 * line,
                f"{each.text}{stacked}",
                transform=axes.transAxes,
                va="top",
                fontsize=9.0,
                color=colour_of(each.aircraft) if recent else MUTED,
                fontweight="bold" if recent else "normal",
            )
        )
    return texts


def _trail(scenario: ReplayScenario, number: int, begin: int, row: int) -> Float[np.ndarray, "_ 2"]:
    """The positions of an aircraft from row `begin` to `row`, without rows in which it is absent.

    In arriving traffic, trails are short, and flights that have left have none.
    """
    flown = scenario.aircraft[number]
    if scenario.has_arrivals:
        if not flown.flies_at(row):
            return flown.position_nm[:0]
        begin = max(begin, row - SHORT_TRAIL)
    return flown.position_nm[max(begin - flown.begins, 0) : max(row + 1 - flown.begins, 0)]


def _blip(sector: Sector, flown: RecordedAircraft, row: int) -> Blip:
    at = row - flown.begins
    return Blip(
        flown.callsign,
        flown.position_nm[at],
        heading_deg=float(flown.heading_deg[at]),
        cleared_heading_deg=float(flown.cleared_heading_deg[at]),
        ground_speed_kt=float(flown.ground_speed_kt[at]),
        fl=float(flown.fl[at]),
        cleared_fl=float(flown.cleared_fl[at]),
        scale=float(sector.plane.scale(flown.position_nm[at, 1:])[0]),
    )


def _scenario(replay: Replay, number: int) -> ReplayScenario:
    for scenario in replay.scenarios:
        if scenario.number == number:
            return scenario
    first, last = replay.scenarios[0].number, replay.scenarios[-1].number
    raise InputError(f"{replay.title} has no scenario {number} (found: {first} to {last})")
