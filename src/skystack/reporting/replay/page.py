"""The replay as a single HTML file that needs no server and no network.

The page contains the recorded flights as JSON (`page_data`). The folder `web` has its HTML, CSS and
plain JavaScript, which are copied into the file unchanged.
"""

import hashlib
import json
from base64 import b64encode
from collections.abc import Sequence
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import numpy as np
from jaxtyping import Float

import skystack
from skystack.airspace.projection import SCALE_RANGE_NM
from skystack.airspace.sector import Sector
from skystack.io.files import atomic_write, check_output
from skystack.reporting.replay.recording import RecordedAircraft, Replay, ReplayScenario, as_json
from skystack.reporting.replay.side_by_side import read_side_by_side
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S

FORMAT = 4
PARTS = {"nm": 10_000, "fl": TICKS_PER_FL, "deg": 100, "kt": 10, "ft_min": 1}
"""The resolution of each unit: values are stored as multiples of 1/`PARTS`. Positions must be
finer than the tolerance of the separation; levels and rates of climb are stored exactly."""
SCRIPTS = (
    *("plane", "data", "separation", "prune", "display", "player", "view", "blocks", "radar"),
    *("measure", "scope", "panels", "profile", "timeline", "alerts", "scan", "exports"),
    *("options", "controls", "main"),
)
"""In the order of their dependencies, `main` last; together they are one JavaScript module."""


def write_replay(
    runs: Sequence[Path], output: Path, scenarios: int | None = None, only: int | None = None
) -> dict[str, Any]:
    """Write the page of one run, or of two side by side; the arguments as for `read_replay`.

    Returns `output`, `bytes`, `runs` (their titles) and `scenarios` (their number). Raises
    InputError as `read_side_by_side` does, and if the file cannot be written.
    """
    check_output(output, *runs)
    data = page_data(read_side_by_side(runs, scenarios, only))
    text = render(data, " and ".join(run["title"] for run in data["runs"])).encode()
    atomic_write(output, text)
    return {
        "output": str(output),
        "bytes": len(text),
        "runs": [run["title"] for run in data["runs"]],
        "scenarios": len(data["runs"][0]["scenarios"]),
    }


class Additions(NamedTuple):
    """What a replay and a live session add to the page that they share."""

    what: str
    """The heading."""
    connects_to: str = "'none'"
    """Where its scripts may connect to, as in a Content-Security-Policy."""
    console: str = ""
    """HTML beside the radar."""
    style: str = ""
    before: str = ""
    """Scripts that run before `main`."""
    after: str = ""


REPLAY = Additions("Radar replay")


def render(data: dict[str, Any], title: str, additions: Additions = REPLAY) -> str:
    """The page that shows `page_data`: a replay, or a live session."""
    web = files("skystack.reporting.replay").joinpath("web")

    def source(name: str) -> str:
        return web.joinpath(name).read_text("utf-8")

    *shared, main = (source(f"{name}.js") for name in SCRIPTS)
    script = "\n".join([*shared, additions.before, main, additions.after])
    digest = b64encode(hashlib.sha256(script.encode()).digest()).decode()
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    return environment.from_string(source("radar.html")).render(
        title=title,
        what=additions.what,
        sector=data["sector"]["name"],
        style=source("radar.css") + additions.style,
        script=script,
        script_hash=f"sha256-{digest}",  # the only script that the browser may run
        connects_to=additions.connects_to,
        console=additions.console,
        data=as_json(data),
    )


def page_data(replays: tuple[Replay, ...]) -> dict[str, Any]:
    """The data that the page draws. Columns are stored as second differences, which are nearly
    all zero on a straight course."""
    sector = replays[0].sector
    return {
        "format": FORMAT,
        "version": skystack.__version__,
        "cycle_s": CYCLE_S,
        "separation_nm": sector.separation_nm,
        "separation_fl": sector.separation_fl,
        "loss_below_nm": sector.loss_below_nm,
        "plane": {"coefficients": sector.plane.scale.coefficients, "range_nm": SCALE_RANGE_NM},
        "parts": PARTS,
        "sector": _sector(sector),
        "runs": [
            {
                "title": replay.title,
                "scenarios": [_scenario(scenario) for scenario in replay.scenarios],
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
        "bent_legs": {
            json.dumps(leg, separators=(",", ":"), ensure_ascii=False): np.round(path, 3).tolist()
            for leg in sorted({leg for route in sector.routes for leg in pairwise(route)})
            if len(path := sector.path_nm(leg)) > 2
        },
    }


def _scenario(scenario: ReplayScenario) -> dict[str, Any]:
    return {
        "number": scenario.number,
        "cycles": scenario.cycles,
        "success": scenario.success,
        "failures": [each._asdict() for each in scenario.failures],
        "aircraft": [_aircraft(aircraft) for aircraft in scenario.aircraft],
        "clearances": [each._asdict() for each in scenario.clearances],
        "losses": [
            loss._asdict() | {"least_nm": round(loss.least_nm, 3)} for loss in scenario.losses
        ],
    }


def _aircraft(flown: RecordedAircraft) -> dict[str, Any]:
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
        "exit_offset_nm": flown.exit_offset_nm,
        "begins": flown.begins,
        "rows": len(flown.status),
        "x": _second_differences(flown.position_nm[:, 0], "nm"),
        "y": _second_differences(flown.position_nm[:, 1], "nm"),
        "fl": _second_differences(flown.fl, "fl"),
        "heading": _second_differences(flown.heading_deg, "deg"),
        "cleared_heading": _second_differences(flown.cleared_heading_deg, "deg"),
        "cleared_fl": _second_differences(flown.cleared_fl, "fl"),
        "speed_kt": _second_differences(flown.ground_speed_kt, "kt"),
        "climb_ft_min": _second_differences(flown.vertical_speed_ft_min, "ft_min"),
        "status": changes,
    }


def _second_differences(values: Float[np.ndarray, " rows"], unit: str) -> list[int]:
    """Second differences of values in `PARTS` of the unit, without the zeros at the end."""
    whole = np.rint(values * PARTS[unit]).astype(np.int64)
    steps = np.diff(whole, n=2, prepend=[0, 0])
    nonzero = np.flatnonzero(steps)
    end = int(nonzero[-1]) + 1 if len(nonzero) else 1
    kept: list[int] = steps[:end].tolist()
    return kept
