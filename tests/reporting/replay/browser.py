"""A replay page in a real browser, as a viewer uses it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from tests.waiting import HANGS_S

ARGUMENTS = (
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
LAPTOP, PHONE = {"width": 1400, "height": 850}, {"width": 390, "height": 844}

_OF_TESTS = "willReadFrequently"
"""In what Chromium remarks when tests read the pixels of a canvas."""
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
        if (Math.abs(now[at] - before[at]) < 24) continue; // lines are smoothed now so, now so
        const [x, y] = [(at / 4) % width, Math.floor(at / 4 / width)];
        [left, right] = [Math.min(left, x), Math.max(right, x)];
        [top, bottom] = [Math.min(top, y), Math.max(bottom, y)];
    }
    return [left, right, top, bottom];
}
"""
_PLAYED = """
() => new Promise(done => {{
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
            seen.push({look});
        }}
        window.requestAnimationFrame = real;
        real(frame);
        done(seen);
    }};
    play();
}})
"""
"""The page's own frames, called at times of ours."""
HANGS_MS = 1000 * HANGS_S
"""Playwright gives up after 30 s unless told otherwise."""


class Viewer:
    """What is on the page, and what one can do there."""

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
    def said(self) -> list[str]:
        """The log up to now."""
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

    def until(self, condition: str) -> None:
        """Until a JavaScript condition holds (the page forbids Playwright's own way to wait)."""
        look = f"const look = () => ({condition}) ? done() : requestAnimationFrame(look)"
        self.page.evaluate(f"() => new Promise(done => {{ {look}; look(); }})")

    def play(self, frames: int, frame_ms: int, look: str) -> list:
        """Plays so many frames at times that do not depend on the machine.

        Returns what a JavaScript expression gives after each.
        """
        return self.page.evaluate(_PLAYED.format(frames=frames, frame_ms=frame_ms, look=look))

    def settle(self) -> None:
        """Until the radar has been drawn."""
        self.page.evaluate("() => new Promise(r => requestAnimationFrame(() => setTimeout(r)))")

    def pixels(self, name: str) -> int:
        """How many of the first radar's pixels have a colour of the theme."""
        self.settle()
        style = "getComputedStyle(document.documentElement)"
        text = self.page.evaluate(f"{style}.getPropertyValue('--{name}').trim()")
        wanted = [int(text[at : at + 2], 16) for at in (1, 3, 5)]
        return self.page.locator("canvas").first.evaluate(_PIXELS, wanted)

    def changed_by(self, key: str) -> tuple[float, float, float, float]:
        """Left, right, top and bottom of what a key changes on the first radar, in its pixels."""
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
    """Open a page; it must say nothing on the console and ask for nothing but itself."""
    opened = browser.new_context(**({"viewport": LAPTOP, "color_scheme": "dark"} | context))
    page = opened.new_page()
    page.set_default_timeout(HANGS_MS)
    wrong: list[str] = []
    page.on("console", lambda said: _OF_TESTS in said.text or wrong.append(said.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("dialog", lambda dialog: wrong.append(dialog.message))
    address = file.as_uri()
    own = (address, "data:")
    page.on("request", lambda sent: sent.url.startswith(own) or wrong.append(sent.url))
    try:
        page.goto(f"{address}#{link}")
        yield Viewer(page)
        assert wrong == []
    finally:
        opened.close()
