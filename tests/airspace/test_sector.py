"""A hand-made sector: a square of 60 NM with a straight route and one that turns."""

from dataclasses import replace

import numpy as np
import pytest

from skystack.airspace.projection import METRES_PER_NM, WGS84
from skystack.airspace.sector import Sector, turns_deg
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from tests.sectors import FAR_NORTH

SQUARE = Sector(
    name="square",
    origin=(0.0, 0.0),
    area=((-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5)),
    levels_fl=(100, 200),
    fixes={
        "SOUTH": (-0.6, 0.0),
        "SDOOR": (-0.5, 0.0),
        "MIDDLE": (0.0, 0.0),
        "NDOOR": (0.5, 0.0),
        "NORTH": (0.6, 0.0),
        "EDOOR": (0.0, 0.5),
        "EAST": (0.0, 0.6),
    },
    routes=(
        ("SOUTH", "SDOOR", "MIDDLE", "NDOOR", "NORTH"),
        ("SOUTH", "MIDDLE", "EDOOR", "EAST"),
    ),
)
LON_DEGREE_NM = 60.107716411
"""The length of a degree of longitude at the equator."""


def north_nm(lat_deg):
    """The distance north of the equator in the plane: the isometric latitude."""
    eccentricity = np.sqrt(0.0066943799901413165)  # of WGS 84
    sine = np.sin(np.radians(lat_deg))
    return (
        np.degrees(np.arctanh(sine) - eccentricity * np.arctanh(eccentricity * sine))
        * LON_DEGREE_NM
    )


def test_positions_in_the_plane():
    assert SQUARE.fixes_nm["EAST"] == pytest.approx((0.6 * LON_DEGREE_NM, 0.0), abs=1e-6)
    assert SQUARE.fixes_nm["SOUTH"] == pytest.approx((0.0, -north_nm(0.6)), abs=1e-6)
    assert SQUARE.area_nm[1] == pytest.approx((0.5 * LON_DEGREE_NM, -north_nm(0.5)), abs=1e-6)


def test_equal_sectors_have_the_same_hash():
    fixes = dict(reversed(SQUARE.fixes.items()))
    same, other = replace(SQUARE, fixes=fixes), replace(SQUARE, levels_fl=(100, 210))
    assert same == SQUARE
    assert hash(same) == hash(SQUARE)
    assert len({SQUARE, same, other}) == 2


def test_origin_is_at_zero_in_the_plane():
    moved = Sector("moved", (10.0, 20.0), (), (0, 1), {"HERE": (10.0, 20.0)}, ())
    assert moved.fixes_nm["HERE"] == pytest.approx((0.0, 0.0))


def test_shorter_routes_repeat_their_last_fix():
    table = SQUARE.route_table
    assert table.fixes_nm.shape == (2, 5, 2)
    assert table.last_fix.tolist() == [4, 3]
    assert table.fixes_nm[1, 3].tolist() == table.fixes_nm[1, 4].tolist()
    assert table.fixes_nm[1, 4] == pytest.approx(SQUARE.fixes_nm["EAST"], abs=1e-5)


def test_bisectors_halve_the_angle_of_the_legs():
    bisector = SQUARE.route_table.bisector
    assert bisector[0, 0] == pytest.approx((0.0, 1.0))
    assert bisector[0, 1:4] == pytest.approx(np.array([[0.0, 2.0]] * 3))
    assert bisector[0, 4] == pytest.approx((0.0, 1.0))
    assert bisector[1, 1] == pytest.approx((1.0, 1.0), abs=1e-6)
    assert bisector[1, 3] == pytest.approx((1.0, 0.0), abs=1e-6)


def test_first_headings_are_geodesic_bearings():
    assert SQUARE.route_table.first_heading_deg.tolist() == [0.0, 0.0]
    assert SQUARE.first_heading_deg(("MIDDLE", "EAST")) == pytest.approx(90.0)


def test_exit_edges_contain_the_exit_fix():
    north, east = SQUARE.route_table.exit_edge_nm
    corner = np.array([0.5 * LON_DEGREE_NM, north_nm(0.5)])
    assert north == pytest.approx(np.array([corner, corner * (-1, 1)]), abs=1e-5)
    assert east == pytest.approx(np.array([corner * (1, -1), corner]), abs=1e-5)


def distance_nm(sector, point_nm, fix):
    lat, lon = sector.plane.to_degrees(point_nm)
    return WGS84.inv(lon, lat, *sector.fixes[fix][::-1])[2] / METRES_PER_NM


@pytest.mark.parametrize(
    ("sector", "route", "fix"), [(SQUARE, 0, "NDOOR"), (x_plus(), 0, None), (FAR_NORTH, 0, "EASTE")]
)
@pytest.mark.parametrize("exit_nm", [0.5, 5.0])
def test_narrow_exits_end_at_the_given_distance_from_the_fix(sector, route, fix, exit_nm):
    fix = fix or sector.routes[route][-2]
    narrow = replace(sector, exit_nm=exit_nm).route_table.exit_edge_nm[route].astype(np.float64)
    ends = [distance_nm(sector, narrow[end], fix) for end in (0, -1)]
    assert ends == pytest.approx([exit_nm, exit_nm], abs=0.01)
    whole = sector.route_table.exit_edge_nm[route].astype(np.float64)
    along, along_whole = narrow[-1] - narrow[0], whole[-1] - whole[0]
    assert np.dot(along, along_whole) > 0.0  # the inside stays to the left


@pytest.mark.parametrize("sector", [SQUARE, x_plus(), FAR_NORTH])
def test_exits_wider_than_the_edge_are_the_edge(sector):
    wide = replace(sector, exit_nm=1000.0).route_table.exit_edge_nm
    corners = sector.route_table.exit_edge_nm
    assert wide[:, [0, -1]] == pytest.approx(corners[:, [0, -1]], abs=1e-4)


@pytest.mark.parametrize(
    ("sector", "fix", "before"), [(SQUARE, "NDOOR", "MIDDLE"), (FAR_NORTH, "EASTE", "WESTE")]
)
def test_exits_can_lie_before_the_exit_fix(sector, fix, before):
    """The middle of the exit is on the last leg, two miles before the exit fix."""
    inner = replace(sector, exit_before_nm=2.0, exit_nm=3.0).route_table.exit_edge_nm[0]
    middle = inner[[0, -1]].astype(np.float64).mean(axis=0)
    assert distance_nm(sector, middle, fix) == pytest.approx(2.0, abs=0.02)
    legs = distance_nm(sector, middle, before), distance_nm(sector, sector.fixes_nm[fix], before)
    assert legs[1] - legs[0] == pytest.approx(2.0, abs=0.02)


def test_turns_are_positive_to_the_right():
    fixes = {"A": (0.0, 0.0), "B": (0.1, 0.0), "C": (0.1, 0.1), "D": (0.2, 0.1), "E": (0.1, 0.1)}
    assert turns_deg(("A", "B", "C", "D"), fixes) == pytest.approx([90.0, -90.0], abs=0.01)
    assert np.abs(turns_deg(("C", "D", "E"), fixes)) == pytest.approx([180.0], abs=1e-6)


@pytest.mark.parametrize("index", [0, 1])
def test_route_index(index):
    assert SQUARE.route_index(SQUARE.routes[index]) == index


def test_refuses_an_unknown_fix_and_suggests_the_nearest():
    with pytest.raises(InputError, match=r"fix 'MIDLE'.*did you mean 'MIDDLE'\?") as error:
        SQUARE.route_index(("SOUTH", "MIDLE", "EDOOR", "EAST"))
    assert "\n" not in str(error.value)


def test_refuses_an_unknown_route_and_lists_the_known_ones():
    with pytest.raises(InputError, match="SOUTH MIDDLE EDOOR EAST") as error:
        SQUARE.route_index(("SOUTH", "MIDDLE", "NDOOR", "NORTH"))
    assert "square" in str(error.value)
    assert "\n" not in str(error.value)
