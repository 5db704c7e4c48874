"""The output of the verb `sector`: a description of the sector, and a map."""

from collections import Counter
from itertools import pairwise
from pathlib import Path
from textwrap import wrap
from typing import Any

from skystack.airspace.projection import geodesic_leg
from skystack.airspace.sector import Sector, turns_deg
from skystack.errors import InputError
from skystack.io.files import atomic_write, check_output
from skystack.reporting.maps import sector_map
from skystack.reporting.style import as_png, as_svg, house_style
from skystack.reporting.table import Table
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.tasks.flight_time import FlightTimes, flight_times
from skystack.tasks.settings import NavigationSettings

_DEFAULTS, _DEFAULT_FL = NavigationSettings(), 300


def sector_facts(sector: Sector, cycles: int) -> dict[str, Any]:
    """The sector, and for each route its length [NM], turns [deg, positive right] and cycles.

    The cycles are the flight time of the default aircraft type from the start to the exit, in level
    flight at FL300 or the sector's nearest level. `routes_beyond_cycles` counts the routes that
    take more than `cycles`.
    """
    times = _flight_times(sector)
    routes = [
        {
            "route": " ".join(route),
            "length_nm": sum(
                geodesic_leg(sector.fixes[a], sector.fixes[b])[1] for a, b in pairwise(route)
            ),
            "turns_deg": turns_deg(route, sector.fixes),
            "cycles": int(needed),
        }
        for route, needed in zip(sector.routes, times.fastest, strict=True)
    ]
    return {
        "name": sector.name,
        "levels_fl": list(sector.levels_fl),
        "origin": list(sector.origin),
        "separation_nm": sector.separation_nm,
        "separation_fl": sector.separation_fl,
        "first_fixes": sorted({route[0] for route in sector.routes}),
        "airports": _airports(sector),
        "routes": routes,
        "cycles": cycles,
        "routes_beyond_cycles": int((times.fastest > cycles).sum()),
    }


def _airports(sector: Sector) -> dict[str, dict[str, int]]:
    """For each fix inside the area at which routes start or end: how many of them."""
    starts = Counter(route[0] for route in sector.routes if sector.departs(route))
    ends = Counter(route[-1] for route in sector.routes if sector.lands(route))
    return {
        name: {"departures": starts[name], "arrivals": ends[name]} for name in sorted(starts | ends)
    }


def _flight_times(sector: Sector) -> FlightTimes:
    low, high = sector.levels_fl
    level_fl = min(max(_DEFAULT_FL, low), high)
    simulator = Simulator(sector, performance(_DEFAULTS.performance))
    return flight_times(simulator, (level_fl,), _DEFAULTS.disc_nm)


def beyond_cycles(sector: Sector, cycles: int) -> str | None:
    """A warning about routes that take longer than a scenario; None if there are none."""
    return _flight_times(sector).beyond(cycles)


def headlines(facts: dict[str, Any]) -> list[str]:
    """The facts about the sector as a whole, in lines of at most 80 characters."""
    (low, high), (lat, lon) = facts["levels_fl"], facts["origin"]
    starts, routes = facts["first_fixes"], len(facts["routes"])
    first = (
        f"{facts['name']}: FL{low:03d} to FL{high:03d}, {routes} route{'s' * (routes > 1)} from "
        f"{len(starts)} first {'fixes' if len(starts) > 1 else 'fix'} ({', '.join(starts)})"
    )
    airports = [
        f"airport {name} (arrival routes: {number['arrivals']}, departure routes: "
        f"{number['departures']})"
        for name, number in facts["airports"].items()
    ]
    return [
        *wrap(first, 80, subsequent_indent="  "),
        *airports,
        f"separation: {facts['separation_nm']:g} NM or {100 * facts['separation_fl']:,} ft; "
        f"origin: lat {lat:.4f}, lon {lon:.4f}",
    ]


def facts_table(facts: dict[str, Any]) -> Table:
    """One row per route."""
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
    """Draw the sector as `.png` or `.svg`. Raises InputError for any other suffix."""
    if output.suffix not in (".png", ".svg"):
        raise InputError(f"{output}: cannot be drawn (allowed: .png, .svg)")
    check_output(output)
    with house_style():
        figure = sector_map(sector)
        data = as_png(figure) if output.suffix == ".png" else as_svg(figure).encode()
    atomic_write(output, data)
