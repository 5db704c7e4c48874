"""What is replayed: an evaluation of a shipped policy, and flights whose course is a formula."""

import json
import shutil
from pathlib import Path

import pytest
from pyproj import Geod

from skystack.evaluation.evaluate import Conditions, evaluate
from skystack.evaluation.simulate import simulate_file
from skystack.policies.shipped import find_policy
from tests.conftest import NO_BROWSER
from tests.docs.blocks import ROOT
from tests.scenarios import NORTHBOUND

from .browser import ARGUMENTS, HANGS_MS
from .meeting import EVIL, meeting

SCENARIOS = 20
WGS84 = Geod(ellps="WGS84")


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api")
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        pytest.skip(NO_BROWSER)
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(
            executable_path=found, args=ARGUMENTS, timeout=HANGS_MS
        )
        yield started
        started.close()


@pytest.fixture(scope="session")
def evaluation(tmp_path_factory) -> Path:
    """The folder of an evaluation; a policy that loses separation now and then."""
    out = tmp_path_factory.mktemp("evaluation")
    evaluate(find_policy("avoidance"), Conditions(episodes=SCENARIOS), out)
    (folder,) = out.iterdir()
    return folder


@pytest.fixture(scope="session")
def fly(tmp_path_factory):
    """From a scenario file's content to what simulate writes."""

    def flown(name: str, scenario) -> Path:
        folder = tmp_path_factory.mktemp("simulated")
        for sector in (ROOT / "verification" / "simulator" / "sectors").glob("*.json"):
            shutil.copy(sector, folder)
        (folder / "scenario.json").write_text(json.dumps(scenario))
        simulate_file(folder / "scenario.json", folder / f"{name}.parquet")
        return folder / f"{name}.parquet"

    return flown


@pytest.fixture(scope="session")
def one_by_one(fly) -> Path:
    """The meeting; afterwards the second is turned in two clearances."""
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
    """The meeting; afterwards the second is turned in one clearance."""
    return fly("at once", meeting({"cycle": 40, "callsign": "AC2", "heading_deg": 290}))


@pytest.fixture(scope="session")
def alone(fly) -> Path:
    """One aircraft, north of the middle, on its way east."""
    aircraft = {"callsign": "AC1", "route": NORTHBOUND, "lat": 0.2, "lon": 0.0, "fl": 300}
    scenario = {"sector": "x-plus", "performance": "constant", "cycles": 10}
    return fly("alone", scenario | {"aircraft": [aircraft | {"heading_deg": 90}]})


@pytest.fixture(scope="session")
def climbing(fly) -> Path:
    """They meet 2,000 ft apart, until the first is cleared to the level of the second."""
    return fly("climbing", meeting({"cycle": 5, "callsign": EVIL, "fl": 320}, levels=(300, 320)))


@pytest.fixture(scope="session")
def converging(fly) -> Path:
    """Side by side northwards, 21.6 NM apart, one 5 degrees towards the other; separation is lost
    more than 20 minutes later."""
    sides = [(0.0, 0.0), (0.36, 355.0)]
    aircraft = [
        {"callsign": f"AC{n}", "route": NORTHBOUND, "lat": -1.5, "lon": lon, "fl": 300}
        | {"heading_deg": heading}
        for n, (lon, heading) in enumerate(sides, start=1)
    ]
    return fly("converging", {"sector": "x-plus", "cycles": 260, "aircraft": aircraft})


@pytest.fixture(scope="session")
def far_north(fly) -> Path:
    """Two at 65 N, the second 10 NM east of the first by the geodesic; both fly east."""
    lon, _, _ = WGS84.fwd(14.0, 65.0, 90.0, 10.0 * 1852.0)
    route = ["SOUTO", "SOUTH", "MIDDL", "NORTH", "NORTO"]
    aircraft = [
        {"callsign": f"AC{n}", "route": route, "lat": 65.0, "lon": at, "fl": 300, "heading_deg": 90}
        for n, at in enumerate((14.0, lon), start=1)
    ]
    return fly("far north", {"sector": "north.json", "cycles": 5, "aircraft": aircraft})
