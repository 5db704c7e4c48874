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
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.tasks.flight_time import flight_times


def sector_facts(sector: Sector, cycles: int) -> dict[str, Any]:
    """Name, levels, and of each route its length [NM], turns [deg, positive to the right] and the
    least cycles that it takes from the first fix to the exit; how many take more than `cycles`."""
    low, high = sector.levels_fl
    level_fl = min(max(_USUAL_FL, low), high)
    simulator = Simulator(sector, performance("table"))
    times = flight_times(simulator, (level_fl,), disc_nm=0.0)
    routes = [
        {
            "route": " ".join(route),
            "length_nm": sum(
                geodesic_leg(sector.fixes[a], sector.fixes[b])[1] for a, b in pairwise(route)
            ),
            "turns_deg": turns_deg(route, sector.fixes),
            "cycles": int(needed),
        }
        for route, needed in zip(sector.routes, times.cycles, strict=True)
    ]
    return {
        "name": sector.name,
        "levels_fl": list(sector.levels_fl),
        "origin": list(sector.origin),
        "separation_nm": sector.separation_nm,
        "separation_fl": sector.separation_fl,
        "first_fixes": sorted({route[0] for route in sector.routes}),
        "routes": routes,
        "cycles": cycles,
        "routes_beyond_cycles": int((times.cycles > cycles).sum()),
    }


_USUAL_FL = 300


def beyond_cycles(facts: dict[str, Any]) -> str:
    """A line on routes that take longer than a scenario."""
    needed = sorted(route["cycles"] for route in facts["routes"])
    count, all_routes = facts["routes_beyond_cycles"], len(needed)
    which = "no route can" if count == all_routes else f"{count} of {all_routes} routes cannot"
    return (
        f"{which} be flown within {facts['cycles']} cycles: the shortest takes {needed[0]},\n"
        f"the longest {needed[-1]} (--cycles of train and evaluate raises it, or task.cycles)"
    )


def facts_table(facts: dict[str, Any]) -> Table:
    """A row a route."""
    rows = (
        (
            route["route"],
            f"{route['length_nm']:.1f}",
            f"{max(map(abs, route['turns_deg'])):.0f}",
            str(route["cycles"]),
        )
        for route in facts["routes"]
    )
    return Table(("route", "length, NM", "sharpest turn, deg", "cycles to the exit"), tuple(rows))


def write_map(sector: Sector, output: Path) -> None:
    """The sector as a picture, `.png` or `.svg`. Raises InputError for another ending."""
    if output.suffix not in (".png", ".svg"):
        raise InputError(f"{output}: cannot be drawn (allowed: .png, .svg)")
    check_folder_of(output)
    with house_style():
        figure = sector_map(sector)
        data = as_png(figure) if output.suffix == ".png" else as_svg(figure).encode()
    write_aside(output, data)
