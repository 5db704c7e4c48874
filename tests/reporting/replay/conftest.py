"""What is replayed: an evaluation of a shipped policy, and flights whose course is a formula."""

import json
import shutil
from pathlib import Path

import pytest

from skystack.catalogue import find_policy
from skystack.evaluation.judge import Conditions, judge
from skystack.simulate import simulate_file
from tests.scenarios import NORTHBOUND

from .browser import ARGUMENTS
from .meeting import EVIL, meeting

SCENARIOS = 20


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api")
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        pytest.skip("no Chromium on this machine")
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=found, args=ARGUMENTS)
        yield started
        started.close()


@pytest.fixture(scope="session")
def evaluation(tmp_path_factory) -> Path:
    """The folder of an evaluation; a policy that loses separation now and then."""
    out = tmp_path_factory.mktemp("evaluation")
    judge(find_policy("avoidance"), Conditions(episodes=SCENARIOS), out)
    (folder,) = out.iterdir()
    return folder


@pytest.fixture(scope="session")
def fly(tmp_path_factory):
    """From a scenario file's content to what simulate writes."""

    def flown(name: str, scenario) -> Path:
        folder = tmp_path_factory.mktemp("simulated")
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
