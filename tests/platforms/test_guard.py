"""A platform that reports nonsense is caught, and what and whose it is named."""

from pathlib import Path

import numpy as np
import pytest

from skystack.errors import PlatformError
from skystack.platforms.guard import Guarded
from skystack.platforms.protocol import Report
from skystack.simulator.scenario_file import load_scenario

SCENARIO = load_scenario(Path(__file__).parents[2] / "examples" / "head-on.json")
CALLSIGNS = [aircraft.callsign for aircraft in SCENARIO.aircraft]
GOOD = Report(*(np.array([1.0, 2.0]) for _ in Report._fields))


class Canned:
    """Answers with what it was given."""

    def __init__(self, *reports):
        self._reports = iter(reports)

    def reset(self, scenario):
        return next(self._reports)

    def advance(self):
        return next(self._reports)


@pytest.mark.parametrize("name", Report._fields)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_report_that_is_not_finite_names_field_and_aircraft(name, value):
    bad = GOOD._replace(**{name: np.array([1.0, value])})
    platform = Guarded(lambda: Canned(GOOD, GOOD, bad))
    platform.reset(SCENARIO)
    platform.advance()
    with pytest.raises(
        PlatformError, match=f"^reported a {name} of {CALLSIGNS[1]} that is not finite$"
    ):
        platform.advance()


def test_a_report_of_fewer_aircraft_is_named():
    short = GOOD._replace(lat=np.array([1.0]))
    with pytest.raises(PlatformError, match=r"reported \(1,\) of lat for 2"):
        Guarded(lambda: Canned(short)).reset(SCENARIO)
