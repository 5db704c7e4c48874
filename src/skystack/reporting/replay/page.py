"""The replay as one page: everything in a single HTML file, no server, no network.

What is drawn is handed to the page as JSON (`page_data`); how it is drawn stands in `radar.html`,
`radar.css` and `radar.js` beside this module.
"""

from importlib.resources import files
from typing import Any

import jinja2
import numpy as np

import skystack
from skystack.airspace.sector import Sector
from skystack.errors import InputError
from skystack.reporting.replay.recording import (
    Flown,
    Replay,
    ReplayScenario,
    as_json,
)
from skystack.simulator.simulator import CYCLE_S
from skystack.tasks.tracking import SEPARATION_FL, SEPARATION_NM

FORMAT = 1
SCALE = {"nm": 100, "fl": 10, "deg": 10}
"""Whole numbers for positions, levels and angles; speeds are whole by themselves."""


def page(replays: tuple[Replay, ...]) -> str:
    """The page of one replay, or of two of the same scenarios side by side."""
    here = files("skystack.reporting.replay")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    template = environment.from_string(here.joinpath("radar.html").read_text("utf-8"))
    return template.render(
        title=" and ".join(replay.title for replay in replays),
        style=here.joinpath("radar.css").read_text("utf-8"),
        script=here.joinpath("radar.js").read_text("utf-8"),
        data=as_json(page_data(replays)),
    )


def page_data(replays: tuple[Replay, ...]) -> dict[str, Any]:
    """What the page draws. Numbers that change slowly are kept as differences from row to row.

    Raises InputError for two replays that have no scenario in common or are not of one sector.
    """
    first = replays[0]
    common = [scenario.number for scenario in first.scenarios]
    for other in replays[1:]:
        if other.sector != first.sector:
            raise InputError(
                f"{other.title} is of sector {other.sector.name}, {first.title} of "
                f"{first.sector.name} (allowed: side by side in one sector)"
            )
        numbers = {scenario.number for scenario in other.scenarios}
        common = [number for number in common if number in numbers]
    if not common:
        raise InputError(f"{first.title} and {replays[-1].title} have no scenario in common")
    return {
        "format": FORMAT,
        "version": skystack.__version__,
        "cycle_s": CYCLE_S,
        "separation_nm": SEPARATION_NM,
        "separation_fl": SEPARATION_FL,
        "scale": SCALE,
        "sector": _sector(first.sector),
        "runs": [
            {
                "title": replay.title,
                "scenarios": [_scenario(s) for s in replay.scenarios if s.number in common],
            }
            for replay in replays
        ],
    }


def _sector(sector: Sector) -> dict[str, Any]:
    return {
        "name": sector.name,
        "levels_fl": sector.levels_fl,
        "area": np.round(sector.area_nm, 3).tolist(),
        "fixes": {name: np.round(at, 3).tolist() for name, at in sector.fixes_nm.items()},
        "routes": sector.routes,
    }


def _scenario(scenario: ReplayScenario) -> dict[str, Any]:
    return {
        "number": scenario.number,
        "cycles": scenario.cycles,
        "success": scenario.success,
        "aircraft": [_aircraft(aircraft) for aircraft in scenario.aircraft],
        "clearances": [said._asdict() for said in scenario.clearances],
        "losses": [
            loss._asdict() | {"least_nm": round(loss.least_nm, 2)} for loss in scenario.losses
        ],
    }


def _aircraft(flown: Flown) -> dict[str, Any]:
    nm, fl, deg = SCALE["nm"], SCALE["fl"], SCALE["deg"]
    changes = [
        [row, status]
        for row, status in enumerate(flown.status)
        if row == 0 or status != flown.status[row - 1]
    ]
    return {
        "callsign": flown.callsign,
        "type": flown.type,
        "route": flown.route,
        "entry_fl": flown.entry_fl,
        "exit_fl": flown.exit_fl,
        "rows": len(flown.status),
        "x": _differences(flown.position_nm[:, 0] * nm),
        "y": _differences(flown.position_nm[:, 1] * nm),
        "fl": _differences(flown.fl * fl),
        "heading": _differences(flown.heading_deg * deg),
        "cleared_heading": _differences(flown.cleared_heading_deg * deg),
        "cleared_fl": _differences(flown.cleared_fl * fl),
        "speed_kt": _differences(flown.ground_speed_kt),
        "climb_ft_min": _differences(flown.vertical_speed_ft_min),
        "status": changes,
    }


def _differences(values: np.ndarray) -> list[int]:
    """The first value, then what is added from row to row; rounded, the last zeros left out."""
    whole = np.rint(values).astype(np.int64)
    steps = np.diff(whole, prepend=0)
    kept = np.flatnonzero(steps)
    last = int(kept[-1]) + 1 if len(kept) else 1
    found: list[int] = steps[:last].tolist()
    return found
