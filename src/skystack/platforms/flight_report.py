"""What another simulator reports of a flight in arriving traffic."""

from typing import NamedTuple


class FlightReport(NamedTuple):
    """The state of a flight in another simulator."""

    route: tuple[str, ...]
    entry_fl: float
    exit_fl: float
    lat: float
    """Degrees, like `lon`."""
    lon: float
    fl: float
    heading_deg: float
    cleared_heading_deg: float
    """The actual heading if none was cleared."""
    cleared_fl: float
    airspeed_kt: float
    """True airspeed."""
    ground_speed_kt: float
    vertical_speed_ft_min: float
    own_navigation: bool
    next_fix: str | None
    """The fix to which it flies; None if its own navigation has ended."""
    turn_radius_nm: float | None
    """That of its turn to the next fix; 0 without one, None if it is not known yet."""
    held: bool
    """Whether a clearance issued now would be lost."""
    kind: int = 0
    """Index of its type in the types of the performance model."""
    contact_s: float = 0.0
    """The time from which it hears clearances."""
