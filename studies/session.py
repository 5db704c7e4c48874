"""The speed of a live session with some 60 to 90 flights, on its page in a browser.

    python -m studies.session

An hour of `category` traffic runs at 60 times real time, controlled by nobody. The server has one
core, the browser the others. Printed are the cycles flown per second of real time from cycle 130 on
(10 are wanted), the frames of the page per second, the time of a trial of a clearance, the greatest
memory of the server, and the time from the command to the link. It needs the extra `[live]`,
Playwright and Chromium, on Linux.
"""

import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from playwright.sync_api import Page, sync_playwright
from rich.console import Console
from websockets.sync.client import connect
from websockets.typing import Origin

CROWDED, LAST = 130, 600
"""The cycles between which it is measured."""
TRIALS = 20
FRAMES_S = 10
_COUNT_FRAMES = """
seconds => new Promise(done => {
    const begin = performance.now();
    let frames = 0;
    const frame = now => {
        frames += 1;
        if (now - begin < 1000 * seconds) requestAnimationFrame(frame);
        else done(frames / seconds);
    };
    requestAnimationFrame(frame);
})
"""


class Measured(NamedTuple):
    """What was measured of one session."""

    link_s: float
    cycles_per_s: float
    frames_per_s: float
    trial_ms: float
    """The median."""
    flights: int
    memory_mb: float


@contextmanager
def session() -> Iterator[tuple[int, str, float]]:
    """A session on one core: its process, its link, and the seconds until the link was printed."""
    core = {min(os.sched_getaffinity(0))}
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "skystack", "session", "category", "--port", "0"]
        began = time.monotonic()
        with subprocess.Popen(
            [*command, "--out", out], stderr=subprocess.PIPE, text=True
        ) as process:
            os.sched_setaffinity(process.pid, core)
            assert process.stderr is not None
            try:
                link = next(
                    found[0] for line in process.stderr if (found := re.search(r"http://\S+", line))
                )
                yield process.pid, link, time.monotonic() - began
            finally:
                process.terminate()


def cycle_of(page: Page) -> int:
    return int(page.locator("#scrubber").input_value())


def wait_for_cycle(page: Page, cycle: int) -> float:
    """The time at which a cycle has been flown."""
    while cycle_of(page) < cycle:
        page.wait_for_timeout(50)
    return time.monotonic()


def trial_ms(link: str, cookie: str) -> tuple[float, int]:
    """The median time of a trial, and the number of flights."""
    host = link.split("/")[2]
    spent: list[float] = []
    with connect(
        f"ws://{host}/live",
        origin=Origin(f"http://{host}"),
        additional_headers={"Cookie": cookie},
        max_size=None,
    ) as socket:
        socket.send(json.dumps({"do": "follow", "epoch": -1, "updates": 0}))
        news: dict[str, Any] = json.loads(socket.recv())
        born = [each for update in news["updates"] for each in update.get("born", ())]
        flights = news["updates"][-1]["flights"]
        callsigns = [born[row[0]]["callsign"] for row in flights]
        for number, callsign in enumerate(callsigns[:TRIALS], start=1):
            began = time.monotonic()
            text = f"{callsign} right 20 degrees"
            socket.send(json.dumps({"do": "trial", "text": text, "id": number}))
            while json.loads(socket.recv()).get("id") != number:
                pass
            spent.append(1000.0 * (time.monotonic() - began))
    return statistics.median(spent), len(flights)


def measure() -> Measured:
    """Run a session on its page and measure it."""
    with session() as (pid, link, link_s), sync_playwright() as driver:
        chromium = driver.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        with closing(chromium):
            page = chromium.new_page(viewport={"width": 1400, "height": 850})
            page.goto(link)
            page.locator("#speed").select_option("60")
            page.keyboard.press("k")
            began = wait_for_cycle(page, CROWDED)
            cookie = "; ".join(f"{each['name']}={each['value']}" for each in page.context.cookies())
            trial, flights = trial_ms(link, cookie)
            frames: float = page.evaluate(_COUNT_FRAMES, FRAMES_S)
            ended = wait_for_cycle(page, LAST)
        used = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
        assert used is not None
        cycles_per_s = (LAST - CROWDED) / (ended - began)
        return Measured(link_s, cycles_per_s, frames, trial, flights, int(used[1]) / 1000.0)


def main() -> None:
    found = measure()
    Console(width=100).print(
        f"link after {found.link_s:.1f} s; {found.cycles_per_s:.1f} cycles/s; "
        f"{found.frames_per_s:.0f} frames/s; trial {found.trial_ms:.0f} ms with "
        f"{found.flights} flights; {found.memory_mb:.0f} MB"
    )


if __name__ == "__main__":
    main()
