"""Sectors by name: the paper's, ours (files of the package), and other simulators' where installed.

`bluebird:NAME` is a sector of BluebirdDT, read from it when asked for; no copy of it is kept here.
"""

from functools import cache
from importlib import import_module
from importlib.resources import as_file, files
from os import fspath
from pathlib import Path

from skystack.airspace.sector import Sector
from skystack.airspace.sector_file import SectorEntry, file_beside, make_sector, read_sector
from skystack.airspace.xplus import x_plus
from skystack.errors import of_extra, unknown_name
from skystack.io.files import AnyPath

AnySector = AnyPath | SectorEntry
"""A name, a file (.json) or the sector itself."""
_FOLDER = files("skystack").joinpath("sectors")
_ELSEWHERE = {"bluebird": "skystack.platforms.bluebird"}
"""By name, not by import: adapters stand at the edge, and their packages are extras."""


def sector_names() -> list[str]:
    """The sectors that come with the package."""
    shipped = (entry.name for entry in _FOLDER.iterdir())
    return ["x-plus", *sorted(n.removesuffix(".json") for n in shipped if n.endswith(".json"))]


@cache
def sector_named(name: str) -> Sector:
    """The sector of a name. Raises InputError for an unknown one."""
    if name == "x-plus":
        return x_plus()
    platform, colon, inner = name.partition(":")
    if colon and platform in _ELSEWHERE:
        return _from_elsewhere(platform, inner)
    if name not in sector_names():
        raise unknown_name("sector", name, sector_names(), [f"{name}.json"])
    with as_file(_FOLDER.joinpath(f"{name}.json")) as path:
        return make_sector(read_sector(path))


def _from_elsewhere(platform: str, name: str) -> Sector:
    with of_extra(f"sector {platform}:{name}", platform):
        adapter = import_module(_ELSEWHERE[platform])
    found: Sector = adapter.sector_named(name)
    return found


def find_sector(name: AnyPath, folder: AnyPath) -> Sector:
    """The sector of a name, or of a `.json` file beside the one that names it.

    Raises InputError for an unknown name or a file that is no sector.
    """
    name = fspath(name)
    if name.endswith(".json"):
        return make_sector(read_sector(file_beside(Path(folder), name, ".json")))
    return sector_named(name)


def sector_from(given: str | SectorEntry) -> Sector:
    """The sector of settings: a name, or the sector itself."""
    return sector_named(given) if isinstance(given, str) else make_sector(given)


def named_or_read(given: AnySector, folder: Path | None = None) -> str | SectorEntry:
    """A sector for task settings: names and entries as given; `.json` files are read.

    Where a file in `folder` says it, the sector's file lies beside that one or below it; what a
    user says (no folder) may lie anywhere. Raises InputError for an unknown name or a file that is
    no sector.
    """
    if isinstance(given, SectorEntry):
        return given
    given = fspath(given)
    if given.endswith(".json"):
        path = Path(given) if folder is None else file_beside(folder, given, ".json")
        return read_sector(path)
    sector_named(given)
    return given
