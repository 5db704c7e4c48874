"""Recordings: an evaluation of a shipped policy, and flights on calculable paths."""

import json
import shutil
from pathlib import Path

import pytest
from pyproj import Geod

from skystack.evaluation.evaluate import Conditions, evaluate
from skystack.evaluation.simulate import simulate_file
from skystack.policies.shipped import find_policy
from tests.docs.blocks import ROOT
from tests.scenarios import NORTHBOUND

from .meeting import EVIL, meeting

SCENARIOS = 20
WGS84 = Geod(ellps="WGS84")


@pytest.fixture(scope="session")
def evaluation(tmp_path_factory) -> Path:
    """The folder of an evaluation, of a policy that sometimes loses separation."""
    out = tmp_path_factory.mktemp("evaluation")
    evaluate(find_policy("avoidance"), Conditions(episodes=SCENARIOS), out)
    (folder,) = out.iterdir()
    return folder


@pytest.fixture(scope="session")
def fly(tmp_path_factory):
    """A function that simulates the content of a scenario file and returns the output file."""

    def simulate(name: str, scenario) -> Path:
        folder = tmp_path_factory.mktemp("simulated")
        for sector in (ROOT / "verification" / "simulator" / "sectors").glob("*.json"):
            shutil.copy(sector, folder)
        (folder / "scenario.json").write_text(json.dumps(scenario))
        simulate_file(folder / "scenario.json", folder / f"{name}.parquet")
        return folder / f"{name}.parquet"

    return simulate


@pytest.fixture(scope="session")
def one_by_one(fly) -> Path:
    """The meeting. Afterwards the second aircraft is turned with two clearances."""
    return fly(
        "one &amp; <b>one",
        meeting(
            {"cycle": 40, "callsign": "AC2", "heading_deg": 280},
            {"cycle": 41, "callsign": "AC2", "heading_deg": 290},
            {"cycle": 45, "callsign": EVIL, "fl": 320},
        ),
    )


@pytest.fixture(scope="session")
def at_once(fly) -> Path:
    """The meeting. Afterwards the second aircraft is turned with one clearance."""
    return fly("at once", meeting({"cycle": 40, "callsign": "AC2", "heading_deg": 290}))


@pytest.fixture(scope="session")
def alone(fly) -> Path:
    """One aircraft north of the centre, eastbound."""
    aircraft = {"callsign": "AC1", "route": NORTHBOUND, "lat": 0.2, "lon": 0.0, "fl": 300}
    scenario = {"sector": "x-plus", "performance": "constant", "cycles": 10}
    return fly("alone", scenario | {"aircraft": [aircraft | {"heading_deg": 90}]})


@pytest.fixture(scope="session")
def climbing(fly) -> Path:
    """The meeting at 2,000 ft apart, until the first is cleared to the level of the second."""
    return fly("climbing", meeting({"cycle": 5, "callsign": EVIL, "fl": 320}, levels=(300, 320)))


@pytest.fixture(scope="session")
def converging(fly) -> Path:
    """Two northbound aircraft, 21.6 NM apart, one of which turns 5 degrees towards the other.

    Separation is lost more than 20 minutes later.
    """
    sides = [(0.0, 0.0), (0.36, 355.0)]
    aircraft = [
        {"callsign": f"AC{n}", "route": NORTHBOUND, "lat": -1.5, "lon": lon, "fl": 300}
        | {"heading_deg": heading}
        for n, (lon, heading) in enumerate(sides, start=1)
    ]
    return fly("converging", {"sector": "x-plus", "cycles": 260, "aircraft": aircraft})


@pytest.fixture(scope="session")
def far_north(fly) -> Path:
    """Two eastbound aircraft at 65 N, the second 10 NM of geodesic east of the first."""
    lon, _, _ = WGS84.fwd(14.0, 65.0, 90.0, 10.0 * 1852.0)
    route = ["SOUTO", "SOUTH", "MIDDL", "NORTH", "NORTO"]
    aircraft = [
        {"callsign": f"AC{n}", "route": route, "lat": 65.0, "lon": at, "fl": 300, "heading_deg": 90}
        for n, at in enumerate((14.0, lon), start=1)
    ]
    return fly("far north", {"sector": "north.json", "cycles": 5, "aircraft": aircraft})
