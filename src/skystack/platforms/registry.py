"""The platforms by name. Their packages are extras, so adapters are imported when opened."""

from collections.abc import Iterable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from skystack.errors import missing_extra, unknown_name
from skystack.platforms.adoption import BLUEBIRD, BLUESKY, SKYSTACK, Adoption
from skystack.platforms.bluesky_scenario import flown_type as bluesky_flown_type
from skystack.platforms.guard import Guarded
from skystack.platforms.protocol import Platform
from skystack.simulator.performance import DEFAULT_TYPE
from skystack.simulator.scenario_file import Scenario

OWN = "skystack"
PLATFORMS = (OWN, "bluebird", "bluesky")
_NEEDS = {
    "bluebird": ("bluebird-dt", "pebble"),
    "bluesky": ("bluesky-simulator", "pebble"),
}
"""The distributions of each extra; an extra has the name of its platform."""
_ADOPTIONS = {OWN: SKYSTACK, "bluebird": BLUEBIRD, "bluesky": BLUESKY}


def check_platform(name: str) -> None:
    """Raise InputError for a platform that does not exist or whose extra is not installed."""
    if name not in PLATFORMS:
        raise unknown_name("platform", str(name), PLATFORMS)
    # Distributions, not modules: other packages also provide a module named `bluesky`.
    missing = [each for each in _NEEDS.get(name, ()) if not _installed(each)]
    if missing:
        raise missing_extra(f"platform {name}", " and ".join(missing), name)


def _installed(distribution: str) -> bool:
    try:
        return bool(version(distribution))
    except PackageNotFoundError:
        return False


def open_platform(name: str, folder: Path) -> Platform:
    """A platform ready to fly. It writes only into `folder`, which must exist.

    Raises InputError as `check_platform` does, and PlatformError if it does not start.
    """
    check_platform(name)
    return Guarded(partial(_open, name, folder))


def _open(name: str, folder: Path) -> Platform:
    if name == "bluebird":
        from skystack.platforms.bluebird import Bluebird  # noqa: PLC0415

        return Bluebird()
    if name == "bluesky":
        from skystack.platforms.bluesky import BlueSky  # noqa: PLC0415

        return BlueSky(folder)
    from skystack.platforms.own import Skystack  # noqa: PLC0415

    return Skystack()


def adoption_of(platform: str) -> Adoption:
    """How a known platform adopts clearances; the platform is not opened."""
    return _ADOPTIONS[platform]


def flown_type(platform: str, aircraft_type: str) -> str:
    """The type that a platform flies for a given type: the same one if it knows it."""
    return bluesky_flown_type(aircraft_type) if platform == "bluesky" else aircraft_type


def platform_notes(
    platform: str, aircraft_types: Iterable[str] = (DEFAULT_TYPE,), climbs: bool = False
) -> list[str]:
    """Notes for the user on what a platform flies differently than requested.

    `climbs`: whether levels are cleared.
    """
    flown = {each: flown_type(platform, each) for each in sorted(set(aircraft_types))}
    lines = [
        f"{platform} has no {requested}: flown as {substitute}"
        for requested, substitute in flown.items()
        if requested != substitute
    ]
    if climbs and platform == "bluesky":
        lines.append(
            "bluesky limits the speed of a climb or descent to the envelope of its type at the "
            "cleared level"
        )
    return lines


def scenario_notes(platform: str, scenario: Scenario) -> list[str]:
    """`platform_notes` for a scenario, with the source of the speeds of types outside its fleet."""
    types = {aircraft.type for aircraft in scenario.aircraft}
    lines = platform_notes(
        platform, types, any(each.fl is not None for each in scenario.clearances)
    )
    whose = {"bluebird": "of its own tables", "bluesky": f"of {DEFAULT_TYPE}"}.get(platform)
    others = types - {DEFAULT_TYPE, *(member.type for member in scenario.fleet)}
    if whose is None or scenario.performance != "table":
        return lines
    return lines + [f"{platform} flies {each} at the speeds {whose}" for each in sorted(others)]
