"""Films as MP4: the frames, and errors without ffmpeg or with one that fails."""

import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from skystack.cli import main
from skystack.errors import InputError, MissingExtraError
from skystack.reporting.replay import film
from skystack.reporting.replay.film import LAST_FRAME_MS, Span, _FilmScene, video, write_picture
from skystack.reporting.replay.video import as_mp4, find_ffmpeg
from skystack.reporting.style import house_style
from tests.reporting.replay.made import replay

TITLES = ("one", "other")


@pytest.fixture(scope="module")
def ffmpeg():
    try:
        return find_ffmpeg()
    except MissingExtraError:
        pytest.skip("neither imageio-ffmpeg nor ffmpeg is installed")


@pytest.fixture
def no_ffmpeg(monkeypatch, tmp_path):
    """Neither the extra nor a program on the path, which is an empty folder."""
    path = tmp_path / "path"
    path.mkdir()
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setenv("PATH", str(path))
    return path


def decoded(ffmpeg, data, folder, width, height):
    (folder / "film.mp4").write_bytes(data)
    command = [ffmpeg, "-loglevel", "error", "-i", str(folder / "film.mp4")]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(command, capture_output=True, check=True).stdout
    return np.frombuffer(raw, np.uint8).reshape(-1, height, width, 3).astype(float)


def program(folder, text):
    path = folder / "ffmpeg"
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


@pytest.mark.slow
def test_film_shows_every_cycle_and_holds_the_last_one(ffmpeg, tmp_path):
    rows, span, replays = [], Span(5, 12), tuple(replay(title) for title in TITLES)
    data = video(replays, 4, span, ffmpeg, rows.append)
    assert rows == list(range(5, 13))
    assert data[4:8] == b"ftyp"
    assert data.index(b"moov") < data.index(b"mdat")  # plays before it is loaded completely
    with house_style():
        scene = _FilmScene(replays, 4, span)
        expected = [np.asarray(scene.pixels(row), dtype=float) for row in rows]
    height, width, _ = expected[0].shape
    frames = decoded(ffmpeg, data, tmp_path, width + width % 2, height + height % 2)
    assert len(frames) == len(rows) - 1 + LAST_FRAME_MS // 100
    last = len(rows) - 1
    for number, pixels in enumerate(expected):
        nearest = [np.abs(frame[:height, :width] - pixels).mean() for frame in frames[: last + 1]]
        assert np.argmin(nearest) == number
        assert nearest[number] < 2.0  # of 255
    held = np.abs(frames[last:, :height, :width] - expected[-1]).mean(axis=(1, 2, 3))
    assert held.max() < 2.0


@pytest.mark.parametrize("size", [(40, 30), (41, 31), (1, 1)])
def test_pads_frames_of_odd_size_with_white(ffmpeg, tmp_path, size):
    width, height = size
    data = as_mp4([Image.new("RGB", size, (255, 255, 255))] * 3, 10, ffmpeg)
    frames = decoded(ffmpeg, data, tmp_path, width + width % 2, height + height % 2)
    assert len(frames) == 3
    assert frames.min() > 250


def test_missing_ffmpeg_names_the_extra_and_leaves_nothing(no_ffmpeg, evaluation, capsys, tmp_path):
    target = tmp_path / "film.mp4"
    assert main(["replay", str(evaluation), "-o", str(target), "--to", "60"]) == 2
    assert capsys.readouterr().err == (
        "skystack: a film as .mp4 needs ffmpeg, which is not installed "
        "(install skystack with the extra [film]; in a checkout: pip install -e '.[film]')\n"
    )
    assert list(tmp_path.iterdir()) == [no_ffmpeg]


def test_finds_ffmpeg_on_the_path(no_ffmpeg):
    expected = program(no_ffmpeg, "exit 0")
    assert find_ffmpeg() == str(expected)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("exec 0<&-; echo first >&2; echo Unknown encoder libx264 >&2; exit 8", "Unknown encoder"),
        ("cat > /dev/null; exit 3", "cannot encode the film: exit code 3"),
        ("cat > /dev/null", "cannot encode the film: exit code 0"),
    ],
)
def test_a_failing_ffmpeg_leaves_the_old_film(monkeypatch, evaluation, tmp_path, text, message):
    broken = str(program(tmp_path, text))
    monkeypatch.setattr(film, "find_ffmpeg", lambda: broken)
    target = tmp_path / "film.mp4"
    target.write_bytes(b"old")
    with pytest.raises(InputError, match=message):
        write_picture([evaluation], target, 0, 0, 60)
    assert target.read_bytes() == b"old"
    assert {path.name for path in tmp_path.iterdir()} == {"ffmpeg", "film.mp4"}


def test_a_program_that_cannot_be_run_is_named(tmp_path):
    path = tmp_path / "ffmpeg"
    path.write_text("")
    with pytest.raises(InputError, match="ffmpeg: cannot be run: Permission denied"):
        as_mp4([Image.new("RGB", (2, 2))], 10, str(path))


def test_ends_ffmpeg_if_a_frame_cannot_be_drawn(tmp_path):
    pid = tmp_path / "pid"
    endless = program(tmp_path, f"echo $$ > {pid}; trap '' TERM; while :; do sleep 0.1; done")

    def frames():
        yield Image.new("RGB", (2, 2))
        while not pid.exists():
            pass
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        as_mp4(frames(), 10, str(endless))
    command = ["kill", "-0", pid.read_text().strip()]
    assert subprocess.run(command, capture_output=True, check=False).returncode != 0


def test_too_many_cycles_are_refused_before_drawing(monkeypatch):
    monkeypatch.setattr(film, "MAX_FRAMES", 8)
    with pytest.raises(InputError, match=r"a film of 9 cycles \(allowed: 8; --from and --to"):
        video((replay(),), 4, Span(5, 13), "unused")
