"""The replay as one page: everything in a single HTML file, no server, no network.

What is drawn is handed to the page as JSON (`page_data`); how it is drawn stands in the folder
`web` beside this module: HTML, CSS and plain JavaScript, put into one file as they are.
"""

import hashlib
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

import skystack
from skystack.airspace.sector import Sector
from skystack.errors import InputError
from skystack.files import write_aside
from skystack.reporting.replay.recording import (
    Flown,
    Replay,
    ReplayScenario,
    as_json,
    read_replay,
)
from skystack.simulator.simulator import CYCLE_S
from skystack.tasks.tracking import SEPARATION_FL, SEPARATION_NM

FORMAT = 1
SCALE = {"nm": 100, "fl": 10, "deg": 10}
"""Whole numbers for positions, levels and angles; speeds are whole by themselves."""
SCRIPTS = (
    *("data", "separation", "player", "view", "blocks", "radar", "scope"),
    *("panels", "timeline", "controls", "main"),
)
"""In the order in which they need each other: together one module of JavaScript."""
SAME_START_NM = 0.1
"""Other simulators place aircraft as ours does but for rounding."""


def write_replay(runs: Sequence[Path], output: Path, scenarios: int = 100) -> dict[str, Any]:
    """Write the page of one run, or of two side by side; `runs` as for `read_replay`.

    Returns what was written: `output`, `bytes`, `runs` (their titles), `scenarios` (how many).
    Raises InputError for runs that cannot be read or do not belong together, and for a file that
    cannot be written; nothing is written then.
    """
    if not output.parent.is_dir():
        raise InputError(f"{output}: the folder {output.parent} does not exist")
    replays = tuple(read_replay(path, scenarios) for path in runs)
    titles = {replay.title for replay in replays}
    if len(titles) < len(replays):  # of the same name, in different places
        replays = tuple(
            replace(replay, title=str(path)) for replay, path in zip(replays, runs, strict=True)
        )
    data = page_data(replays)
    text = _page(data).encode()
    write_aside(output, text)
    return {
        "output": str(output),
        "bytes": len(text),
        "runs": [run["title"] for run in data["runs"]],
        "scenarios": len(data["runs"][0]["scenarios"]),
    }


def _page(data: dict[str, Any]) -> str:
    web = files("skystack.reporting.replay").joinpath("web")

    def source(name: str) -> str:
        return web.joinpath(name).read_text("utf-8")

    script = "\n".join(source(f"{name}.js") for name in SCRIPTS)
    digest = b64encode(hashlib.sha256(script.encode()).digest()).decode()
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(source("radar.html")).render(
        title=" and ".join(run["title"] for run in data["runs"]),
        sector=data["sector"]["name"],
        style=source("radar.css"),
        script=script,
        script_hash=f"sha256-{digest}",  # the one script that the browser is to run
        data=as_json(data),
    )


def page_data(replays: tuple[Replay, ...]) -> dict[str, Any]:
    """What the page draws. Numbers that change slowly are kept as differences from row to row.

    Two replays are shown in the scenarios that they have in common. Raises InputError where there
    is none, where they are not of one sector or where aircraft start elsewhere.
    """
    first = replays[0]
    common = {scenario.number for scenario in first.scenarios}
    for other in replays[1:]:
        common &= _comparable(first, other)
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


def _comparable(first: Replay, other: Replay) -> set[int]:
    """The numbers of the scenarios that both hold, the same in both."""
    if other.sector != first.sector:
        raise InputError(
            f"{other.title} is of sector {other.sector.name}, {first.title} of "
            f"{first.sector.name} (allowed: side by side in one sector)"
        )
    known = {scenario.number: scenario for scenario in first.scenarios}
    common = [scenario for scenario in other.scenarios if scenario.number in known]
    if not common:
        raise InputError(f"{first.title} and {other.title} have no scenario in common")
    for scenario in common:
        if not _same_start(known[scenario.number], scenario):
            raise InputError(
                f"scenario {scenario.number} of {other.title} begins otherwise than that of "
                f"{first.title} (allowed: side by side the same scenarios)"
            )
    return {scenario.number for scenario in common}


def _same_start(one: ReplayScenario, other: ReplayScenario) -> bool:
    who = [[(each.callsign, each.route) for each in s.aircraft] for s in (one, other)]
    if who[0] != who[1]:
        return False
    start = [np.array([each.position_nm[0] for each in s.aircraft]) for s in (one, other)]
    return bool(np.all(np.abs(start[0] - start[1]) < SAME_START_NM))


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
