"""The one protocol that every simulator of air traffic is flown through.

    reset(scenario) -> report     traffic of a scenario at cycle 0; nobody has been told anything
    issue(instruction)            tell one aircraft something; no time passes
    advance() -> report           one radar cycle of 6 s; everybody flies
    close()                       give back what is held; nothing may be called afterwards

Reports are in the units of the tables, so an adapter needs to know nothing of our simulator.
"""

from collections.abc import Container
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from skystack.errors import InputError
from skystack.platforms.adoption import Adoption
from skystack.platforms.instruction import Instruction
from skystack.simulator.scenario_file import Scenario


class Report(NamedTuple):
    """The traffic as a platform has it, in the order of the scenario's aircraft; float64."""

    lat: Float[np.ndarray, " aircraft"]
    """Degrees, like `lon`."""
    lon: Float[np.ndarray, " aircraft"]
    """In [-180, 180)."""
    fl: Float[np.ndarray, " aircraft"]
    heading_deg: Float[np.ndarray, " aircraft"]
    """In [0, 360)."""
    cleared_heading_deg: Float[np.ndarray, " aircraft"]
    """The heading last cleared; the actual one where none was."""
    cleared_fl: Float[np.ndarray, " aircraft"]
    ground_speed_kt: Float[np.ndarray, " aircraft"]
    vertical_speed_ft_min: Float[np.ndarray, " aircraft"]


@runtime_checkable
class Platform(Protocol):
    """A simulator that flies scenarios, one after another; see the module's docstring.

    It prints nothing, writes only into the folder it was opened with, and flies a scenario the
    same whatever was flown before. Anything may raise PlatformError: the simulator itself failed.
    """

    @property
    def adoption(self) -> Adoption:
        """When it begins to fly a clearance, and which way it turns."""

    def reset(self, scenario: Scenario) -> Report:
        """Begin a scenario; its clearances are for the caller to issue.

        Raises InputError for a scenario that this simulator cannot fly.
        """

    def issue(self, instruction: Instruction) -> None:
        """Clear an aircraft of the scenario before the next cycle is flown.

        Of the words only a direction of turn to obey counts (`by_direction`).

        Raises InputError for an instruction that this simulator cannot fly.
        """

    def advance(self) -> Report:
        """Fly one cycle. An aircraft that the simulator has lost is a PlatformError."""

    def close(self) -> None:
        """Give back what is held."""


def names_of_ours(scenario: Scenario) -> dict[str, str]:
    """Names by callsign, in order, for platforms that cannot name every callsign."""
    return {one.callsign: f"AC{index:04d}" for index, one in enumerate(scenario.aircraft)}


def check_types(scenario: Scenario, known: Container[str], who: str, allowed: str) -> None:
    """Raise InputError for an aircraft type that a platform does not know."""
    for aircraft in scenario.aircraft:
        if aircraft.type not in known:
            raise InputError(
                f"{aircraft.callsign}: type {aircraft.type!r} is unknown to {who} "
                f"(allowed: {allowed})"
            )
