"""Sectors by name: the paper's sector, the package's sector files, and those of other simulators.

`bluebird:NAME` is a sector of BluebirdDT. It is read from the installed package; skystack does not
include a copy.
"""

from functools import cache
from importlib import import_module
from importlib.resources import as_file, files
from os import fspath
from pathlib import Path

from skystack.airspace.sector import Sector
from skystack.airspace.sector_file import SectorEntry, file_in_folder, make_sector, read_sector
from skystack.airspace.xplus import x_plus
from skystack.errors import requires_extra, unknown_name
from skystack.io.files import AnyPath

AnySector = AnyPath | SectorEntry
"""The name of a sector, the path of a `.json` file, or the sector itself."""
_FOLDER = files("skystack").joinpath("sectors")
_ADAPTERS = {"bluebird": "skystack.platforms.bluebird"}
"""Imported by name when needed: the adapters are in a higher layer and need optional packages."""


def sector_names() -> list[str]:
    """The names of the sectors in the package."""
    shipped = (entry.name for entry in _FOLDER.iterdir())
    return ["x-plus", *sorted(n.removesuffix(".json") for n in shipped if n.endswith(".json"))]


@cache
def sector_named(name: str) -> Sector:
    """The sector with the given name. Raises InputError if it is unknown."""
    if name == "x-plus":
        return x_plus()
    platform, colon, inner = name.partition(":")
    if colon and platform in _ADAPTERS:
        return _platform_sector(platform, inner)
    if name not in sector_names():
        raise unknown_name("sector", name, sector_names(), [f"{name}.json"])
    with as_file(_FOLDER.joinpath(f"{name}.json")) as path:
        return make_sector(read_sector(path))


def _platform_sector(platform: str, name: str) -> Sector:
    with requires_extra(f"sector {platform}:{name}", platform):
        adapter = import_module(_ADAPTERS[platform])
    sector: Sector = adapter.sector_named(name)
    return sector


def find_sector(name: AnyPath, folder: AnyPath | None = None) -> Sector:
    """The sector with the given name, or the sector of a `.json` file.

    `folder` is the folder of the file that names the sector; a sector file must then be in it or
    below it. Without `folder` any path is allowed. Raises InputError for an unknown name or an
    invalid sector file.

    Example:

        >>> import skystack
        >>> sector = skystack.find_sector("x-plus")  # or a file: "valley.json"
        >>> len(sector.routes), sector.separation_nm
        (10, 5.0)
    """
    return sector_from(sector_setting(name, None if folder is None else Path(folder)))


def sector_from(setting: str | SectorEntry) -> Sector:
    """The sector of a task's `sector` setting: a name, or the sector itself."""
    return sector_named(setting) if isinstance(setting, str) else make_sector(setting)


def sector_setting(sector: AnySector, folder: Path | None = None) -> str | SectorEntry:
    """The value for a task's `sector` setting. A `.json` file is read; others are unchanged.

    `folder` is the folder of the file that names the sector; a sector file must then be in it or
    below it. Without `folder` (the user names the sector) any path is allowed. Raises InputError
    for an unknown name or an invalid sector file.
    """
    if isinstance(sector, SectorEntry):
        return sector
    name = fspath(sector)
    if name.endswith(".json"):
        path = Path(name) if folder is None else file_in_folder(folder, name, ".json")
        return read_sector(path)
    sector_named(name)
    return name
