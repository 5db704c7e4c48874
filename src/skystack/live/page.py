"""The page of a live session: the radar page of replays, with a console to control the traffic."""

from importlib.resources import files

from skystack.airspace.sector import Sector
from skystack.reporting.replay.page import Additions, page_data, render
from skystack.reporting.replay.recording import Replay, ReplayScenario

BEFORE, AFTER = ("live_player", "growth"), ("draft", "advice", "monitor", "session")
"""Scripts in the folder `web` that run before and after the `main` of replays."""


def live_page(sector: Sector, title: str) -> str:
    """The page for a session in a sector. Its traffic arrives over a websocket."""
    web = files("skystack.live").joinpath("web")

    def source(*names: str) -> str:
        return "\n".join(web.joinpath(name).read_text("utf-8") for name in names)

    nothing = ReplayScenario(0, 0, None, (), (), ())
    data = page_data((Replay(title, sector, (nothing,)),))
    additions = Additions(
        what="Live session",
        connects_to="'self'",
        console=source("console.html"),
        style=source("console.css"),
        before=source(*(f"{name}.js" for name in BEFORE)),
        after=source(*(f"{name}.js" for name in AFTER)),
    )
    return render(data | {"live": True}, title, additions)
