"""Scenario files for tests: a minimal one, and variants of it."""

import copy
import json
from pathlib import Path

from skystack.simulator.scenario_file import load_scenario

EXAMPLES = Path(__file__).parents[1] / "examples"
NORTHBOUND = ["HERON", "CRANE", "EGL", "MACAW", "QUAIL", "SWIFT"]

MINIMAL = {
    "sector": "x-plus",
    "cycles": 12,
    "aircraft": [
        {"callsign": "AC1", "route": NORTHBOUND, "lat": -0.41, "lon": -0.41, "fl": 300},
        {"callsign": "AC2", "route": NORTHBOUND[::-1], "lat": 0.7, "lon": 0.7, "fl": 300},
    ],
    "clearances": [{"cycle": 3, "callsign": "AC1", "heading_deg": 35}],
}


def changed(where, value, of=MINIMAL):
    """A copy of a scenario with one field set, or removed if the value is `...`."""
    scenario = copy.deepcopy(of)
    *steps, last = where
    at = scenario
    for step in steps:
        at = at[step]
    if value is ...:
        del at[last]
    else:
        at[last] = value
    return scenario


def renamed(callsign, of=MINIMAL):
    """A copy of a scenario with another callsign for AC1."""
    return json.loads(json.dumps(of).replace('"AC1"', json.dumps(callsign)))


def load(scenario, folder):
    """Write a scenario (or the text of one) to a file, and load it."""
    path = folder / "scenario.json"
    path.write_text(scenario if isinstance(scenario, str) else json.dumps(scenario))
    return load_scenario(path)
