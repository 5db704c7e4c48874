"""Invalid reports and exceptions of a platform become clear errors."""

from pathlib import Path

import numpy as np
import pytest

from skystack.errors import InputError, PlatformError
from skystack.platforms.adoption import BLUESKY
from skystack.platforms.guard import Guarded
from skystack.platforms.instruction import Instruction
from skystack.platforms.protocol import Report
from skystack.simulator.scenario_file import load_scenario

SCENARIO = load_scenario(Path(__file__).parents[2] / "examples" / "head-on.json")
CALLSIGNS = [aircraft.callsign for aircraft in SCENARIO.aircraft]
GOOD = Report(*(np.array([1.0, 2.0]) for _ in Report._fields))


class Canned:
    """A platform that returns given reports."""

    def __init__(self, *reports):
        self._reports = iter(reports)

    def reset(self, scenario):
        return next(self._reports)

    def advance(self):
        return next(self._reports)


@pytest.mark.parametrize("name", Report._fields)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_names_field_and_aircraft_of_non_finite_values(name, value):
    bad = GOOD._replace(**{name: np.array([1.0, value])})
    platform = Guarded(lambda: Canned(GOOD, GOOD, bad))
    platform.reset(SCENARIO)
    platform.advance()
    with pytest.raises(
        PlatformError, match=f"^reported a {name} of {CALLSIGNS[1]} that is not finite$"
    ):
        platform.advance()


def test_rejects_reports_of_too_few_aircraft():
    short = GOOD._replace(lat=np.array([1.0]))
    with pytest.raises(PlatformError, match=r"reported lat of shape \(1,\) for 2 aircraft"):
        Guarded(lambda: Canned(short)).reset(SCENARIO)


def test_names_the_first_of_several_invalid_values():
    both = GOOD._replace(fl=np.array([np.nan, np.nan]), lon=np.array([1.0, np.inf]))
    with pytest.raises(PlatformError, match=f"reported a lon of {CALLSIGNS[1]} that is not"):
        Guarded(lambda: Canned(both)).reset(SCENARIO)
    with pytest.raises(PlatformError, match=f"reported a fl of {CALLSIGNS[0]} that is not"):
        Guarded(lambda: Canned(both._replace(lon=GOOD.lon))).reset(SCENARIO)


def test_wraps_longitudes():
    far = GOOD._replace(lon=np.array([180.0, -190.0]))
    platform = Guarded(lambda: Canned(far, far))
    for report in (platform.reset(SCENARIO), platform.advance()):
        assert report.lon.tolist() == [-180.0, 170.0]
        assert report.lat.tolist() == GOOD.lat.tolist()


class Failing:
    """A platform whose methods all raise a given error."""

    def __init__(self, error):
        self._error = error

    def reset(self, scenario):
        raise self._error

    issue = reset

    def advance(self):
        raise self._error

    close = advance


@pytest.mark.parametrize(
    ("error", "kind", "message"),
    [
        (KeyError("AC1"), PlatformError, "failed: KeyError: 'AC1'"),
        (ValueError("two\n  lines"), PlatformError, "failed: ValueError: two lines"),
        (SystemExit(3), PlatformError, "failed: SystemExit: 3"),
        (PlatformError("lost AC1"), PlatformError, "lost AC1"),
        (InputError("fl is 3"), InputError, "fl is 3"),
        (KeyboardInterrupt(), KeyboardInterrupt, ""),
    ],
)
def test_converts_exceptions_to_one_line_errors(error, kind, message):
    platform = Guarded(lambda: Failing(error))
    methods = (
        lambda: platform.reset(SCENARIO),
        lambda: platform.issue(Instruction("AC1", 90)),
        platform.advance,
        platform.close,
    )
    for call in methods:
        with pytest.raises(kind) as raised:
            call()
        assert str(raised.value) == message
    with pytest.raises(kind):
        Guarded(lambda: Failing(error).advance())


class Recording:
    """A platform that records calls."""

    adoption = BLUESKY

    def __init__(self):
        self.calls = []

    def issue(self, instruction):
        self.calls.append(instruction)

    def close(self):
        self.calls.append("closed")


def test_passes_calls_to_the_platform():
    inner = Recording()
    platform = Guarded(lambda: inner)
    instruction = Instruction("AC1", 90)
    platform.issue(instruction)
    platform.close()
    assert inner.calls == [instruction, "closed"]
    assert platform.adoption is BLUESKY
