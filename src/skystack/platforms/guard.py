"""A platform that keeps its promises: whatever goes wrong in it becomes one clear error."""

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from skystack.airspace.projection import wrap_longitude
from skystack.errors import InputError, PlatformError
from skystack.platforms.adoption import Adoption
from skystack.platforms.instruction import Instruction
from skystack.platforms.protocol import Platform, Report
from skystack.simulator.scenario_file import Scenario

Answer = TypeVar("Answer")


class Guarded:
    """A platform whose own errors are PlatformErrors and whose reports are whole and finite.

    Their longitudes are in [-180, 180), whatever the platform counts them from.
    """

    def __init__(self, opened: Callable[[], Platform]) -> None:
        self._platform = _ask(opened)
        self._callsigns: tuple[str, ...] = ()

    @property
    def adoption(self) -> Adoption:
        return self._platform.adoption

    def reset(self, scenario: Scenario) -> Report:
        self._callsigns = tuple(aircraft.callsign for aircraft in scenario.aircraft)
        return self._checked(_ask(self._platform.reset, scenario))

    def issue(self, instruction: Instruction) -> None:
        _ask(self._platform.issue, instruction)

    def advance(self) -> Report:
        return self._checked(_ask(self._platform.advance))

    def close(self) -> None:
        _ask(self._platform.close)

    def _checked(self, report: Report) -> Report:
        for name, values in report._asdict().items():
            if values.shape != (len(self._callsigns),):
                count = len(self._callsigns)
                raise PlatformError(f"reported {values.shape} of {name} for {count}")
            wrong = np.flatnonzero(~np.isfinite(values))
            if wrong.size:
                callsign = self._callsigns[wrong[0]]
                raise PlatformError(f"reported a {name} of {callsign} that is not finite")
        return report._replace(lon=wrap_longitude(report.lon))


def _ask(question: Callable[..., Answer], *arguments: Any) -> Answer:
    """Call a platform; a simulator may raise anything, and even try to exit."""
    try:
        return question(*arguments)
    except (InputError, PlatformError):
        raise
    except (Exception, SystemExit) as error:
        text = " ".join(str(error).split())
        raise PlatformError(f"failed: {type(error).__name__}: {text}") from error
