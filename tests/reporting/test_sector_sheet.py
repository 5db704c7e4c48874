"""The description of a sector, and its map."""

from dataclasses import replace

from skystack.reporting.sector_sheet import headlines, sector_facts, write_map
from tests.airspace.test_sector import SQUARE

AIRPORT = replace(
    SQUARE,
    routes=(("SOUTH", "SDOOR", "MIDDLE"), ("MIDDLE", "EDOOR", "EAST"), *SQUARE.routes),
)


def test_airports_are_named_with_their_routes():
    facts = sector_facts(AIRPORT, 300)
    assert facts["airports"] == {"MIDDLE": {"departures": 1, "arrivals": 1}}
    assert "airport MIDDLE (arrival routes: 1, departure routes: 1)" in headlines(facts)
    assert sector_facts(SQUARE, 300)["airports"] == {}


def test_the_time_of_an_arrival_is_that_to_its_landing():
    """Both routes lead north from SOUTH; the other one leads on beyond the airport."""
    arrival, _, through, _ = (route["cycles"] for route in sector_facts(AIRPORT, 300)["routes"])
    assert arrival < through


def test_a_sector_is_drawn_if_its_first_route_lands(tmp_path):
    """The width of an airway is drawn at the first route that leaves the area."""
    write_map(AIRPORT, tmp_path / "map.png")
    write_map(replace(AIRPORT, routes=AIRPORT.routes[:1]), tmp_path / "arrivals.svg")
    assert (tmp_path / "map.png").stat().st_size > 1000
    assert (tmp_path / "arrivals.svg").stat().st_size > 1000
