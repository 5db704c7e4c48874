"""Stills and films: what is drawn where, the number of frames, and what is rejected."""

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
from skystack.reporting.style import PAPER, VERMILION, house_style
from tests.reporting.replay.made import ROWS, replay

from .conftest import WGS84


def test_draws_aircraft_at_their_positions():
    """Squares are hollow. In a loss of separation they are filled, with a cross."""
    recording = replay()
    with house_style():
        scene = _FilmScene((recording,), 4, Span(0, ROWS - 1))
        (axes,) = scene._panels
        for row in (0, 10, 16):
            pixels = np.asarray(scene.pixels(row)) / 255.0
            lost = row == 10
            for number, each in enumerate(recording.scenarios[0].aircraft):
                x, y = axes.transData.transform(each.position_nm[row])
                colour = to_rgb(VERMILION if lost else colour_of(number))
                # Northwards, where neither the line ahead nor the label is.
                at = [
                    pixels[round(pixels.shape[0] - y - 0.5 - up), round(x - 0.5)]
                    for up in (0, 2, 4)
                ]
                assert at[0] == pytest.approx(to_rgb(PAPER), abs=0.1)  # the cross, or the inside
                assert at[1] == pytest.approx(colour if lost else to_rgb(PAPER), abs=0.3)
                assert at[2] == pytest.approx(colour, abs=0.3)


def test_names_the_pair_that_loses_separation():
    with house_style():
        scene = _Scene((replay(),), 4, Span(0, ROWS - 1))
        (axes,) = scene._panels
        for row, texts in ((7, []), (8, ["loss of separation: AC1 and AC2"])):
            scene.draw(row)
            found = [each.get_text() for each in axes.texts]
            assert [text for text in found if text.startswith("loss")] == texts


def test_scale_bar_is_true_in_the_middle_of_the_map(far_north):
    recording = read_replay(far_north)
    with house_style():
        scene = _Scene((recording,), 0, Span(0, 5))
    (axes,) = scene._panels
    (bar,) = [line.get_xydata() for line in axes.lines if line.get_marker() == "|"]
    (text,) = [each.get_text() for each in axes.texts if each.get_text().endswith(" NM")]
    middle = np.mean(axes.get_ylim())
    ends = bar * [1.0, 0.0] + [0.0, middle]
    assert true_nm(recording, *ends) == pytest.approx(float(text.split()[0]), rel=2e-3)
    assert 0.08 < (bar[1, 0] - bar[0, 0]) / np.ptp(axes.get_xlim()) <= 0.25


def test_rings_and_lines_have_true_lengths_far_north(far_north):
    """By geodesics: the ring of a loss of separation, and the line of the next two minutes."""
    (scenario,) = (recording := read_replay(far_north)).scenarios
    lost = replace(scenario, losses=(Loss(0, 1, 0, 5, 4.0),))
    with house_style():
        scene = _Scene((replace(recording, scenarios=(lost,)),), 0, Span(0, 5))
        scene.draw(3)
    (axes,) = scene._panels
    rings = [patch for patch in axes.patches if isinstance(patch, Circle)]
    assert len(rings) == 2
    for ring in rings:
        centre = np.array(ring.center)
        edge = centre + np.array([[0.0, ring.radius], [ring.radius, 0.0], [-ring.radius, 0.0]])
        for point in edge:
            assert true_nm(recording, centre, point) == pytest.approx(5.0, rel=2e-3)
    speed_kt = scenario.aircraft[0].ground_speed_kt[3]
    ahead = [line.get_xydata() for line in axes.lines if line.get_zorder() == 8.5]
    assert len(ahead) == 4
    for start, end in ahead:
        assert true_nm(recording, start, end) == pytest.approx(speed_kt / 30.0, rel=2e-3)


def true_nm(recording, start, end):
    (lat, lon), (end_lat, end_lon) = recording.sector.plane.to_degrees(np.stack([start, end]))
    return WGS84.inv(lon, lat, end_lon, end_lat)[2] / 1852.0


def test_panel_lists_the_clearances_issued_so_far():
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


@pytest.mark.slow
def test_film_has_one_frame_per_cycle_and_is_deterministic():
    rows = []
    data = film((replay("one"), replay("other")), 4, Span(5, 12), rows.append)
    assert rows == list(range(5, 13))
    assert data == film((replay("one"), replay("other")), 4, Span(5, 12))
    moving = Image.open(io.BytesIO(data))
    assert moving.n_frames == 8
    assert moving.info["duration"] == 100  # ten cycles of 6 s per second, 60 times real time
    single = Image.open(io.BytesIO(film((replay("one"),), 4, Span(5, 6))))
    assert moving.size[0] == pytest.approx(2 * single.size[0], abs=2)


def test_stills_are_png_or_svg():
    recordings = (replay(callsigns=("<img src=x>", "$AC2$")),)
    picture = Image.open(io.BytesIO(still(recordings, 4, Span(0, 10), "png")))
    assert picture.format == "PNG"
    drawing = still(recordings, 4, Span(0, 10), "svg")
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
def test_rejects_missing_scenarios_and_invalid_times(number, from_s, to_s, message):
    with pytest.raises(InputError) as error:
        span_of((replay(),), number, from_s, to_s)
    assert str(error.value).startswith(message)


def test_times_are_rounded_down_to_cycles():
    assert span_of((replay(),), 4, 13, 59) == Span(2, 9)
    assert span_of((replay(),), 4, 0, None) == Span(0, ROWS - 1)


def test_rejects_a_film_that_is_too_long(monkeypatch):
    monkeypatch.setattr("skystack.reporting.replay.film.MAX_FRAMES", 8)
    recordings = (replay(),)
    assert Image.open(io.BytesIO(film(recordings, 4, Span(5, 12)))).n_frames == 8
    with pytest.raises(InputError, match=r"a film of 9 cycles \(allowed: 8; --from and --to"):
        film(recordings, 4, Span(5, 13))


def test_frames_look_like_stills():
    """Frames draw many aircraft at once and paste labels; nearly all pixels are the same."""
    recording = replay()
    with house_style():
        frame = np.asarray(_FilmScene((recording,), 4, Span(0, ROWS - 1)).pixels(10)).astype(int)
        scene = _Scene((recording,), 4, Span(0, ROWS - 1))
        scene.draw(10)
        scene._canvas.draw()
        still_frame = np.asarray(scene._canvas.buffer_rgba())[:, :, :3].astype(int)
    differs = np.abs(frame - still_frame).max(axis=2) > 96
    drawn = np.abs(still_frame - still_frame[0, 0]).max(axis=2) > 96
    assert differs.sum() < 0.05 * drawn.sum()
