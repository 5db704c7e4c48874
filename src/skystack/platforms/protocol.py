"""The protocol of all air traffic simulators.

    reset(scenario) -> report     start a scenario: its traffic at cycle 0, no clearances issued
    issue(instruction)            clear one aircraft; no time passes
    advance() -> report           one radar cycle of 6 s; all aircraft fly
    close()                       release all resources; nothing may be called afterwards

Reports are in the units of the tables, so that an adapter does not depend on skystack's simulator.
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
    """The platform's traffic, in the order of the scenario's aircraft; float64."""

    lat: Float[np.ndarray, " aircraft"]
    """Degrees, like `lon`."""
    lon: Float[np.ndarray, " aircraft"]
    """In [-180, 180)."""
    fl: Float[np.ndarray, " aircraft"]
    heading_deg: Float[np.ndarray, " aircraft"]
    """In [0, 360)."""
    cleared_heading_deg: Float[np.ndarray, " aircraft"]
    """The last cleared heading; the actual heading if none was cleared."""
    cleared_fl: Float[np.ndarray, " aircraft"]
    ground_speed_kt: Float[np.ndarray, " aircraft"]
    vertical_speed_ft_min: Float[np.ndarray, " aircraft"]


@runtime_checkable
class Platform(Protocol):
    """A simulator that flies scenarios, one after another; see the module's docstring.

    It prints nothing, writes only into the folder it was opened with, and flies a scenario
    independently of earlier ones. Every method may raise PlatformError if the simulator fails.
    """

    @property
    def adoption(self) -> Adoption:
        """When it adopts a clearance, and which way it turns."""

    def reset(self, scenario: Scenario) -> Report:
        """Start a scenario; the caller issues its clearances.

        Raises InputError for a scenario that this simulator cannot fly.
        """

    def issue(self, instruction: Instruction) -> None:
        """Clear an aircraft of the scenario before the next cycle is flown.

        `turn` counts only with `by_direction`; `vertical` is wording only.

        Raises InputError for an instruction that this simulator cannot fly.
        """

    def advance(self) -> Report:
        """Fly one cycle. Raises PlatformError if the simulator has lost an aircraft."""

    def close(self) -> None:
        """Release all resources."""


def substitute_callsigns(scenario: Scenario) -> dict[str, str]:
    """Substitute names by callsign, in order, for platforms that do not accept every callsign."""
    return {one.callsign: f"AC{index:04d}" for index, one in enumerate(scenario.aircraft)}


def check_types(scenario: Scenario, known: Container[str], platform: str, allowed: str) -> None:
    """Raise InputError for an aircraft type that a platform does not know."""
    for aircraft in scenario.aircraft:
        if aircraft.type not in known:
            raise InputError(
                f"{aircraft.callsign}: type {aircraft.type!r} is unknown to {platform} "
                f"(allowed: {allowed})"
            )
