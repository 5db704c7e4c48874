"""The platforms by name. Their packages are extras: each adapter is imported when it is opened."""

from collections.abc import Iterable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from skystack.errors import missing_extra, unknown_name
from skystack.platforms.bluesky_scenario import flown_type as bluesky_flown_type
from skystack.platforms.guard import Guarded
from skystack.platforms.instruction import AT_ONCE, NEXT_CYCLE, Adoption
from skystack.platforms.protocol import Platform
from skystack.simulator.performance import DEFAULT_TYPE

OWN = "skystack"
PLATFORMS = (OWN, "bluebird", "bluesky")
_NEEDS = {
    "bluebird": ("bluebird-dt", "pebble"),
    "bluesky": ("bluesky-simulator", "pebble"),
}
"""Distributions of each extra; extra and platform have one name."""


def check_platform(name: str) -> None:
    """Raise InputError for a platform that does not exist or whose extra is not installed."""
    if name not in PLATFORMS:
        raise unknown_name("platform", name, PLATFORMS)
    # By distribution: other packages go by the name of BlueSky's module.
    missing = [each for each in _NEEDS.get(name, ()) if not _installed(each)]
    if missing:
        raise missing_extra(f"platform {name}", " and ".join(missing), name)


def _installed(distribution: str) -> bool:
    try:
        return bool(version(distribution))
    except PackageNotFoundError:
        return False


def open_platform(name: str, folder: Path) -> Platform:
    """A platform ready to fly; it writes, if at all, into `folder`, which must exist.

    Raises InputError as `check_platform` does, PlatformError when it does not start.
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


def flown_type(platform: str, aircraft_type: str) -> str:
    """The type that a platform flies for a given one: the same, where it knows it."""
    return bluesky_flown_type(aircraft_type) if platform == "bluesky" else aircraft_type


def adoption_of(platform: str) -> Adoption:
    """When and how a platform begins to fly a clearance, without opening it."""
    return AT_ONCE if platform == "bluesky" else NEXT_CYCLE


def said_of(platform: str, aircraft_types: Iterable[str] = (DEFAULT_TYPE,)) -> list[str]:
    """What must be said of a platform: the types that it flies as others."""
    flown = {each: flown_type(platform, each) for each in aircraft_types}
    return [
        f"{platform} has no {asked}: flown as {instead}"
        for asked, instead in flown.items()
        if asked != instead
    ]
