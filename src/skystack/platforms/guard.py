"""A wrapper that turns every failure of a platform into one clear error."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from skystack.airspace.projection import wrap_longitude
from skystack.errors import InputError, PlatformError
from skystack.platforms.adoption import Adoption
from skystack.platforms.instruction import Instruction
from skystack.platforms.protocol import Platform, Report
from skystack.simulator.scenario_file import Scenario

Result = TypeVar("Result")


class Guarded:
    """A platform that raises PlatformError for all its own errors and for incomplete reports.

    Reports are finite, and their longitudes are in [-180, 180).
    """

    def __init__(self, opened: Callable[[], Platform]) -> None:
        self._platform = _call(opened)
        self._callsigns: tuple[str, ...] = ()

    @property
    def adoption(self) -> Adoption:
        return self._platform.adoption

    def reset(self, scenario: Scenario) -> Report:
        self._callsigns = tuple(aircraft.callsign for aircraft in scenario.aircraft)
        return self._checked(_call(self._platform.reset, scenario))

    def issue(self, instruction: Instruction) -> None:
        _call(self._platform.issue, instruction)

    def advance(self) -> Report:
        return self._checked(_call(self._platform.advance))

    def close(self) -> None:
        _call(self._platform.close)

    def _checked(self, report: Report) -> Report:
        for name, values in report._asdict().items():
            if values.shape != (len(self._callsigns),):
                count = len(self._callsigns)
                raise PlatformError(f"reported {name} of shape {values.shape} for {count} aircraft")
            wrong = np.flatnonzero(~np.isfinite(values))
            if wrong.size:
                callsign = self._callsigns[wrong[0]]
                raise PlatformError(f"reported a {name} of {callsign} that is not finite")
        return report._replace(lon=wrap_longitude(report.lon))


def _call(method: Callable[..., Result], *arguments: Any) -> Result:
    """Call a platform; a simulator may raise anything, even SystemExit."""
    try:
        return method(*arguments)
    except (InputError, PlatformError):
        raise
    except (Exception, SystemExit) as error:
        text = " ".join(str(error).split())
        raise PlatformError(f"failed: {type(error).__name__}: {text}") from error
