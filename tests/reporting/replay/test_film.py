"""Stills and films: what is drawn where, how many frames, what is refused."""

import io
from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.patches import Circle
from PIL import Image

from skystack.errors import InputError
from skystack.reporting.radar import colour_of
from skystack.reporting.replay.film import Span, _FilmScene, _Scene, film, span_of, still
from skystack.reporting.replay.recording import Loss, read_replay
from skystack.reporting.style import VERMILION, house_style
from tests.reporting.replay.made import ROWS, replay

from .conftest import WGS84

FIRST = "AC1 turn right heading 090 (3 instructions)"


def test_aircraft_are_drawn_where_they_are():
    """The middle of each square has the aircraft's colour, or that of a loss of separation."""
    made = replay()
    with house_style():
        scene = _FilmScene((made,), 4, Span(0, ROWS - 1))
        (axes,) = scene._panels
        for row in (0, 10, 16):
            pixels = np.asarray(scene.pixels(row)) / 255.0
            for number, each in enumerate(made.scenarios[0].aircraft):
                x, y = axes.transData.transform(each.position_nm[row])
                colour = VERMILION if row == 10 else colour_of(number)
                seen = pixels[round(pixels.shape[0] - y), round(x)]
                assert seen == pytest.approx(to_rgb(colour), abs=0.02)


def test_rings_and_lines_have_their_true_lengths_far_north(far_north):
    """By geodesics: the ring of a loss of separation, and the way of the next two minutes."""
    (scenario,) = (made := read_replay(far_north)).scenarios
    lost = replace(scenario, losses=(Loss(0, 1, 0, 5, 4.0),))
    with house_style():
        scene = _Scene((replace(made, scenarios=(lost,)),), 0, Span(0, 5))
        scene.draw(3)
    (axes,) = scene._panels
    rings = [patch for patch in axes.patches if isinstance(patch, Circle)]
    assert len(rings) == 2
    for ring in rings:
        centre = np.array(ring.center)
        edge = centre + np.array([[0.0, ring.radius], [ring.radius, 0.0], [-ring.radius, 0.0]])
        for point in edge:
            assert true_nm(made, centre, point) == pytest.approx(5.0, rel=2e-3)
    speed_kt = scenario.aircraft[0].ground_speed_kt[3]
    ahead = [line.get_xydata() for line in axes.lines if line.get_zorder() == 8.5]
    assert len(ahead) == 4
    for start, end in ahead:
        assert true_nm(made, start, end) == pytest.approx(speed_kt / 30.0, rel=2e-3)


def true_nm(made, start, end):
    (lat, lon), (end_lat, end_lon) = made.sector.plane.to_degrees(np.stack([start, end]))
    return WGS84.inv(lon, lat, end_lon, end_lat)[2] / 1852.0


def test_the_panel_says_what_has_been_said_so_far():
    with house_style():
        scene = _Scene((replay("policy"),), 4, Span(0, ROWS - 1))
        (axes,) = scene._panels
        kept = set(axes.get_children())
        for row, title, texts in (
            (2, "policy\n0 clearances, time 00:12", []),
            (
                3,
                "policy\n1 clearance, time 00:18",
                ["AC1 turn right heading 090 (3 instructions)"],
            ),
            (
                13,
                "policy\n2 clearances, time 01:18",
                ["AC2 fly heading 270", "AC1 turn right heading 090 (3 instructions)"],
            ),
        ):
            scene.draw(row)
            assert axes.get_title(loc="left") == title
            new = [each for each in axes.texts if each not in kept]
            assert [each.get_text() for each in new if "heading" in each.get_text()] == texts
            for artist in set(axes.get_children()) - kept:
                artist.remove()


def test_a_film_has_a_frame_a_cycle_and_is_the_same_again():
    rows = []
    data = film((replay("one"), replay("other")), 4, Span(5, 12), rows.append)
    assert rows == list(range(5, 13))
    assert data == film((replay("one"), replay("other")), 4, Span(5, 12))
    moving = Image.open(io.BytesIO(data))
    assert moving.n_frames == 8
    assert moving.info["duration"] == 100  # ten a second: 6 s each are sixty times real time
    alone = Image.open(io.BytesIO(film((replay("one"),), 4, Span(5, 6))))
    assert moving.size[0] == pytest.approx(2 * alone.size[0], abs=2)


def test_stills_are_pictures_and_drawings():
    made = (replay(callsigns=("<img src=x>", "$AC2$")),)
    picture = Image.open(io.BytesIO(still(made, 4, Span(0, 10), "png")))
    assert picture.format == "PNG"
    drawing = still(made, 4, Span(0, 10), "svg")
    assert {each.tag for each in ET.fromstring(drawing).iter()}.isdisjoint({"img", "script"})


@pytest.mark.parametrize(
    ("number", "from_s", "to_s", "message"),
    [
        (5, 0, None, "made has no scenario 5 (found: 4 to 4)"),
        (4, 60, 30, "--from 60 --to 30 (allowed: times from 0 to 120 s, the earlier one first)"),
        (4, 0, 126, "--from 0 --to 126 (allowed: times from 0 to 120 s, the earlier one first)"),
        (4, 600, None, "--from 600 --to 120 (allowed: times from 0 to 120 s"),
    ],
)
def test_what_is_not_there_is_refused(number, from_s, to_s, message):
    with pytest.raises(InputError) as error:
        span_of((replay(),), number, from_s, to_s)
    assert str(error.value).startswith(message)


def test_times_are_rounded_down_to_cycles():
    assert span_of((replay(),), 4, 13, 59) == Span(2, 9)
    assert span_of((replay(),), 4, 0, None) == Span(0, ROWS - 1)


def test_a_film_that_is_too_long_is_refused_before_it_is_drawn(monkeypatch):
    monkeypatch.setattr("skystack.reporting.replay.film.MOST_FRAMES", 8)
    made = (replay(),)
    assert Image.open(io.BytesIO(film(made, 4, Span(5, 12)))).n_frames == 8
    with pytest.raises(InputError, match=r"a film of 9 cycles \(allowed: 8; --from and --to"):
        film(made, 4, Span(5, 13))


def test_frames_show_what_a_still_shows():
    """Drawn together or one by one, labels pasted: nearly every pixel is the same."""
    made = replay()
    with house_style():
        frame = np.asarray(_FilmScene((made,), 4, Span(0, ROWS - 1)).pixels(10)).astype(int)
        scene = _Scene((made,), 4, Span(0, ROWS - 1))
        scene.draw(10)
        scene._canvas.draw()
        still_frame = np.asarray(scene._canvas.buffer_rgba())[:, :, :3].astype(int)
    differs = np.abs(frame - still_frame).max(axis=2) > 96
    drawn = np.abs(still_frame - still_frame[0, 0]).max(axis=2) > 96
    assert differs.sum() < 0.05 * drawn.sum()
