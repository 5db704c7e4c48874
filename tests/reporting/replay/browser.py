"""A replay page in a real browser, operated as by a viewer."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from tests.waiting import TIMEOUT_S

ARGUMENTS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
LAPTOP, PHONE = {"width": 1400, "height": 850}, {"width": 390, "height": 844}

_CANVAS_NOTICE = "willReadFrequently"
"""Part of Chromium's console message when tests read the pixels of a canvas."""
_PIXELS = """
(canvas, wanted) => {
    const {width, height} = canvas;
    const data = canvas.getContext("2d").getImageData(0, 0, width, height).data;
    const near = at => wanted.every((value, part) => Math.abs(data[at + part] - value) < 12);
    let count = 0;
    for (let at = 0; at < data.length; at += 4) count += near(at);
    return count;
}
"""
_CHANGED = """
([canvas, before]) => {
    const {width, height} = canvas;
    const now = canvas.getContext("2d").getImageData(0, 0, width, height).data;
    let [left, right, top, bottom] = [width, 0, height, 0];
    for (let at = 0; at < now.length; at += 4) {
        if (Math.abs(now[at] - before[at]) < 24) continue; // anti-aliasing varies
        const [x, y] = [(at / 4) % width, Math.floor(at / 4 / width)];
        [left, right] = [Math.min(left, x), Math.max(right, x)];
        [top, bottom] = [Math.min(top, y), Math.max(bottom, y)];
    }
    return [left, right, top, bottom];
}
"""
_PLAY = """
    const real = requestAnimationFrame;
    let frame = null, seen = [];
    window.requestAnimationFrame = next => frame = next;
    const play = () => {{
        if (frame === null) return setTimeout(play);
        const begun = performance.now();
        frame(begun);
        document.querySelector(".play").click();
        for (let number = 1; number <= {frames}; ++number) {{
            frame(begun + number * {frame_ms});
            seen.push({expression});
        }}
        window.requestAnimationFrame = real;
        real(frame);
        done(seen);
    }};
    play();
"""
"""Calls the page's own frame callback at given times."""
TIMEOUT_MS = 1000 * TIMEOUT_S
"""Playwright's default is 30 s."""


class Viewer:
    """What a viewer can see and do on the page."""

    def __init__(self, page) -> None:
        self.page = page

    def keys(self, *names: str) -> None:
        for name in names:
            self.page.keyboard.press(name)

    @property
    def row(self) -> int:
        return int(self.page.locator("#scrubber").input_value())

    @property
    def alerts(self) -> list[str]:
        return self.page.locator(".alerts li").all_text_contents()

    @property
    def counts(self) -> list[int]:
        return [int(text) for text in self.page.locator(".count strong").all_text_contents()]

    @property
    def log(self) -> list[str]:
        """The log entries up to the current row."""
        return self.page.locator(".log li:not(.to-come) .text").all_text_contents()

    @property
    def selected(self) -> list[str]:
        return self.page.locator(".strip[aria-pressed=true] .callsign").all_text_contents()

    @property
    def link(self) -> dict[str, list[str]]:
        self.keys("l")
        return parse_qs(urlsplit(self.page.evaluate("location.href")).fragment)

    def scrub_to(self, row: int) -> None:
        self.page.locator("#scrubber").fill(str(row))

    def wait_until(self, condition: str) -> None:
        """Wait for a JavaScript condition; the page's policy blocks Playwright's own waits."""
        check = f"const check = () => ({condition}) ? done() : requestAnimationFrame(check)"
        self._finish(f"{{ {check}; check(); }}")

    def play(self, frames: int, frame_ms: int, expression: str) -> list:
        """Play a number of frames at times that do not depend on the machine.

        Returns the value of a JavaScript expression after each frame.
        """
        script = _PLAY.format(frames=frames, frame_ms=frame_ms, expression=expression)
        return self._finish(script)

    def settle(self) -> None:
        """Wait until the radar has been drawn."""
        self._finish("requestAnimationFrame(() => setTimeout(done))")

    def _finish(self, script: str) -> Any:
        """Run JavaScript until it calls `done`; returns what it is called with.

        Playwright has no time limit for promises.
        """
        limit = f"setTimeout(() => fail(new Error('timed out')), {TIMEOUT_MS})"
        return self.page.evaluate(f"() => new Promise((done, fail) => {{ {limit}; {script} }})")

    def pixels(self, name: str) -> int:
        """The number of the first radar's pixels that have a colour of the theme."""
        self.settle()
        style = "getComputedStyle(document.documentElement)"
        text = self.page.evaluate(f"{style}.getPropertyValue('--{name}').trim()")
        wanted = [int(text[at : at + 2], 16) for at in (1, 3, 5)]
        return self.page.locator("canvas").first.evaluate(_PIXELS, wanted)

    def changed_by(self, key: str) -> tuple[float, float, float, float]:
        """Left, right, top and bottom of the area that a key changes on the first radar [px]."""
        self.settle()
        canvas = self.page.locator("canvas").first
        before = canvas.evaluate_handle(
            "c => c.getContext('2d').getImageData(0, 0, c.width, c.height).data"
        )
        self.keys(key)
        self.settle()
        handles = [canvas.element_handle(), before]
        left, right, top, bottom = self.page.evaluate(_CHANGED, handles)
        self.keys(key)
        return left, right, top, bottom


@contextmanager
def viewing(browser, file: Path, link: str = "", **context) -> Iterator[Viewer]:
    """Open a page, which must write nothing to the console and request nothing but itself."""
    opened = browser.new_context(**({"viewport": LAPTOP, "color_scheme": "dark"} | context))
    page = opened.new_page()
    page.set_default_timeout(TIMEOUT_MS)
    problems: list[str] = []
    page.on(
        "console", lambda message: _CANVAS_NOTICE in message.text or problems.append(message.text)
    )
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("dialog", lambda dialog: problems.append(dialog.message))
    address = file.as_uri()
    own = (address, "data:")
    page.on("request", lambda request: request.url.startswith(own) or problems.append(request.url))
    try:
        page.goto(f"{address}#{link}")
        yield Viewer(page)
        assert problems == []
    finally:
        opened.close()
