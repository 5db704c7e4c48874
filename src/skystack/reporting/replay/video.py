"""Films as MP4 (H.264), encoded by ffmpeg: that of the extra `[film]`, else one on the path."""

import shutil
import subprocess
from collections.abc import Iterable
from contextlib import suppress
from itertools import chain
from pathlib import Path

from PIL import Image

from skystack.errors import InputError, missing_extra
from skystack.io.files import scratch_folder

_EVEN = "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"
"""H.264 with halved colour resolution, which all players show, needs an even width and height."""
_OUTPUT = ("-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p", "-movflags", "+faststart")


def find_ffmpeg() -> str:
    """The path of ffmpeg. Raises MissingExtraError if there is none."""
    try:
        from imageio_ffmpeg import get_ffmpeg_exe  # noqa: PLC0415

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):  # RuntimeError: it has no ffmpeg for this machine
        found = shutil.which("ffmpeg")
    if found is None:
        raise missing_extra("a film as .mp4", "ffmpeg", "film")
    return found


def as_mp4(frames: Iterable[Image.Image], frames_per_s: int, ffmpeg: str) -> bytes:
    """Encode RGB frames of one size, at least one. Raises InputError if ffmpeg fails."""
    waiting = iter(frames)
    first = next(waiting)
    with scratch_folder("skystack-film-") as folder:
        target, messages = folder / "film.mp4", folder / "messages.txt"
        size = f"{first.width}x{first.height}"
        source = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(frames_per_s))
        command = [ffmpeg, "-nostdin", "-loglevel", "error", *source, "-i", "pipe:0"]
        command += ["-vf", _EVEN, *_OUTPUT, str(target)]
        code = _run(command, chain([first], waiting), messages)
        if code != 0 or not target.exists():
            lines = messages.read_text("utf-8", "replace").split("\n")
            reason = next((line for line in reversed(lines) if line.strip()), f"exit code {code}")
            raise InputError(f"{ffmpeg}: cannot encode the film: {reason.strip()}")
        return target.read_bytes()


def _run(command: list[str], frames: Iterable[Image.Image], messages: Path) -> int:
    """Pass the frames to ffmpeg, which is killed if one cannot be drawn; returns its exit code."""
    with messages.open("wb") as errors:
        try:
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=errors
            )
        except OSError as error:
            raise InputError(f"{command[0]}: cannot be run: {error.strerror}") from None
    with process:
        assert process.stdin is not None
        try:
            with suppress(BrokenPipeError):  # it has failed; its exit code is not 0
                for frame in frames:
                    process.stdin.write(frame.tobytes())
            with suppress(BrokenPipeError):
                process.stdin.close()
            return process.wait()
        finally:
            process.kill()  # no effect if it has ended
            with suppress(BrokenPipeError):
                process.stdin.close()
