"""The verb `sector`: what a sector is, in a table and as a map."""

from itertools import pairwise
from pathlib import Path
from typing import Any

from skystack.airspace.projection import geodesic_leg
from skystack.airspace.sector import Sector, turns_deg
from skystack.errors import InputError
from skystack.files import check_folder_of, write_aside
from skystack.reporting.maps import sector_map
from skystack.reporting.style import as_png, as_svg, house_style
from skystack.reporting.tables import Table


def sector_facts(sector: Sector) -> dict[str, Any]:
    """Name, levels, and of each route its length [NM] and turns [deg, positive to the right]."""
    routes = [
        {
            "route": " ".join(route),
            "length_nm": sum(
                geodesic_leg(sector.fixes[a], sector.fixes[b])[1] for a, b in pairwise(route)
            ),
            "turns_deg": turns_deg(route, sector.fixes),
        }
        for route in sector.routes
    ]
    return {
        "name": sector.name,
        "levels_fl": list(sector.levels_fl),
        "origin": list(sector.origin),
        "first_fixes": sorted({route[0] for route in sector.routes}),
        "routes": routes,
    }


def facts_table(facts: dict[str, Any]) -> Table:
    """A row a route."""
    rows = (
        (
            route["route"],
            f"{route['length_nm']:.1f}",
            f"{max(map(abs, route['turns_deg'])):.0f}",
        )
        for route in facts["routes"]
    )
    return Table(("route", "length, NM", "sharpest turn, deg"), tuple(rows))


def write_map(sector: Sector, output: Path) -> None:
    """The sector as a picture, `.png` or `.svg`. Raises InputError for another ending."""
    if output.suffix not in (".png", ".svg"):
        raise InputError(f"{output}: cannot be drawn (allowed: .png, .svg)")
    check_folder_of(output)
    with house_style():
        figure = sector_map(sector)
        data = as_png(figure) if output.suffix == ".png" else as_svg(figure).encode()
    write_aside(output, data)
