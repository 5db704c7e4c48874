"""Film a live session in a browser: a picture for the documentation, and a short film.

    python -m tools.film_session docs/images

A person asks for advice, accepts some of it, selects a clearance with the buttons, and hands all
flights over to the search. It needs the extra `[live]`, Playwright and Chromium.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright

SIZE = {"width": 1280, "height": 800}
FILM_SIZE = (960, 600)
FRAMES_PER_S = 2
COLOURS = 128
COMMAND = (
    *("-m", "skystack", "session", "120", "--seed", "0", "--adviser", "search", "--new"),
    *("--port", "0"),
)


class Camera:
    """Takes the frames of a film."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self.frames: list[Image.Image] = []

    def film(self, seconds: float) -> None:
        """Film for some seconds of the viewer's time."""
        for _ in range(round(seconds * FRAMES_PER_S)):
            self._page.wait_for_timeout(1000 / FRAMES_PER_S)
            self.take()

    def take(self) -> None:
        with tempfile.NamedTemporaryFile(suffix=".png") as file:
            self._page.screenshot(path=file.name)
            picture = (
                Image.open(file.name).convert("RGB").resize(FILM_SIZE, Image.Resampling.LANCZOS)
            )
        self.frames.append(picture)

    def save(self, path: Path) -> None:
        """Save the frames as a GIF with one palette."""
        sample = Image.fromarray(np.vstack([np.asarray(each) for each in self.frames[::12]]))
        palette = sample.quantize(COLOURS, Image.Quantize.FASTOCTREE)
        frames = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in self.frames]
        first, *others = frames
        first.save(
            path,
            save_all=True,
            append_images=others,
            duration=round(1000 / FRAMES_PER_S),
            loop=0,
            optimize=True,
        )


def play(page: Page, camera: Camera, picture: Path) -> None:
    """What the person does."""

    def wait(selector: str, text: str = "") -> None:
        page.locator(selector).filter(has_text=text).first.wait_for()

    def until(cycle: int) -> None:
        while int(page.locator("#scrubber").input_value()) < cycle:
            camera.film(0.5)

    wait("#who", "You control")
    page.locator("#speed").select_option("60")
    page.keyboard.press("k")
    until(110)
    page.keyboard.press("k")
    is_conflict = False
    for _ in range(6):
        page.keyboard.press("q")
        wait("#alternatives", "Accept")
        page.locator("#alternatives li").nth(1).hover()
        camera.film(2)
        found = "separation is lost" in page.locator("#situation").inner_text()
        if not picture.exists() or (found and not is_conflict):
            page.screenshot(path=picture)
            is_conflict = found
        page.keyboard.press("Alt+1")
        wait("#answer", "”")
        camera.film(1)
        page.keyboard.press("ArrowRight")
    callsign = page.locator(".strip:visible .callsign").first.inner_text()
    page.locator(".strip", has_text=callsign).first.click()
    wait("#ladder", "300")
    camera.film(2)
    page.locator("#ladder .exit").click()
    page.locator("#fixes button").last.click()
    wait("#trial", callsign)
    camera.film(3)
    page.locator("#issue button").click()
    camera.film(2)
    page.keyboard.press("Escape")
    page.keyboard.press("x")
    camera.film(1)
    page.keyboard.press("k")
    until(260)


def film(folder: Path) -> None:
    """Run a session, film it, and write `session.png` and `session.gif` into a folder."""
    picture = folder / "session.png"
    picture.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as out, sync_playwright() as driver:
        command = [sys.executable, *COMMAND, "--out", out]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:
            assert process.stderr is not None
            link = next(
                found[0] for line in process.stderr if (found := re.search(r"http://\S+", line))
            )
            chromium = driver.chromium.launch(
                executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
            )
            with closing(chromium):
                page = chromium.new_page(viewport=SIZE, color_scheme="dark")
                page.goto(link)
                camera = Camera(page)
                play(page, camera, picture)
                camera.save(folder / "session.gif")
        finally:
            process.terminate()
            process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    film(parser.parse_args().folder)


if __name__ == "__main__":
    main()
