"""Maps of the sector: names, widths, routes, and lines drawn side by side."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from skystack.airspace.projection import METRES_PER_NM, WGS84, geodesic_leg
from skystack.airspace.sector_file import Point, SectorEntry, make_sector
from skystack.airspace.sectors import find_sector
from skystack.airspace.xplus import XPlus, x_plus
from skystack.reporting.maps import along, beside, route_maps, sector_map
from skystack.reporting.style import as_png, house_style

VALLEY = Path(__file__).parents[2] / "examples" / "own-sector" / "valley.json"


def texts_of(axes):
    return [text.get_text() for text in axes.texts if text.get_text()]


@pytest.mark.parametrize("half_width_nm", [8.0, 10.0])
def test_sector_map_names_fixes_levels_and_width(half_width_nm):
    sector = XPlus(half_width_nm=half_width_nm).sector()
    with house_style():
        (axes,) = sector_map(sector).axes
    assert axes.get_title(loc="left") == "X-Plus sector, FL200 to FL400"
    assert sorted(set(sector.fixes) & set(texts_of(axes))) == sorted(sector.fixes)
    assert f"{2.0 * half_width_nm:.0f} NM" in texts_of(axes)
    assert axes.get_aspect() == 1.0
    assert "NM" in axes.get_xlabel()


def test_lengths_are_true_where_edges_are_curved():
    """Far north, over 7 degrees of latitude. The length of the exit edge is from pyproj."""
    ring = [[5.0, 59.0], [25.0, 58.0], [19.0, 64.0], [11.0, 66.0]]
    fixes = {
        "S": {"lat": 58.0, "lon": 13.0},
        "N": {"lat": 65.0, "lon": 15.0},
        "O": {"lat": 65.3, "lon": 15.0},
    }
    area = {"type": "Polygon", "coordinates": [ring]}
    sector = make_sector(SectorEntry(
        "far north", (200, 400), area, {name: Point(**at) for name, at in fixes.items()},
        (("S", "N", "O"),),
    ))  # fmt: skip
    assert len(sector.edge_through("N")) > 2
    with house_style():
        (axes,) = sector_map(sector).axes
    width_nm = WGS84.inv(19.0, 64.0, 11.0, 66.0)[2] / METRES_PER_NM
    assert f"{width_nm:.0f} NM" in texts_of(axes)
    (bar,) = (line for line in axes.lines if line.get_marker() == "|")
    ends = sector.plane.to_degrees(bar.get_xydata())
    length_nm = geodesic_leg(*(tuple(map(float, end)) for end in ends))[1]
    assert length_nm == pytest.approx(20.0, rel=1e-3)


@pytest.mark.parametrize(
    ("sector", "is_drawn"), [("x-plus", True), (VALLEY, False)], ids=["x-plus", "valley"]
)
def test_width_of_the_exit_is_drawn_only_inside_the_area(sector, is_drawn):
    sector = find_sector(sector)
    with house_style():
        (axes,) = sector_map(sector).axes
    arrows = [text for text in axes.texts if not text.get_text()]  # the only one without a text
    assert bool(arrows) == is_drawn
    for arrow in arrows:
        line = shapely.LineString([arrow.xy, arrow.xyann])
        inner = line.interpolate(np.linspace(0.05, 0.95, 10), normalized=True)
        assert all(shapely.Polygon(sector.area_nm).contains(point) for point in inner)


def test_names_do_not_overlap_and_stay_inside():
    with house_style():
        figures = [sector_map(x_plus()), route_maps(x_plus())]
    for axes in (axes for figure in figures for axes in figure.axes):
        texts = [text for text in axes.texts if text.get_text()]
        boxes = [text.get_window_extent() for text in texts]
        assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
        frame = axes.get_window_extent()
        assert all(frame.count_contains(box.corners()) == 4 for box in boxes)


def test_routes_are_grouped_by_first_fix_with_distinct_dashes():
    sector = x_plus()
    with house_style():
        panels = route_maps(sector).axes
    seen = []
    for axes in panels:
        lines = [line for line in axes.lines if not line.get_label().startswith("_")]
        routes = [tuple(line.get_label().split(" \N{EN DASH} ")) for line in lines]
        assert {f"From {route[0]}" for route in routes} == {axes.get_title(loc="left")}
        assert len({str(line._unscaled_dash_pattern) for line in lines}) == len(lines)
        assert set(sector.fixes) <= set(texts_of(axes))
        seen += routes
    assert sorted(seen) == sorted(sector.routes)


@given(st.floats(-80.0, 80.0), st.floats(-3.0, 3.0))
def test_parallel_line_keeps_its_distance_around_a_corner(turn_deg, offset_nm):
    radians = np.radians(turn_deg)
    corner = np.array([0.0, 10.0])
    path = np.array(
        [[0.0, 0.0], corner, corner + 10.0 * np.array([np.sin(radians), np.cos(radians)])]
    )
    shifted = beside(path, offset_nm)
    for start, end, near in zip(path[:-1], path[1:], (shifted[:2], shifted[1:]), strict=True):
        east, north = (end - start) / 10.0
        right = np.array([north, -east])
        np.testing.assert_allclose((near - start) @ right, offset_nm, atol=1e-9)


def test_points_along_a_line_are_dense_and_include_corners():
    path = np.array([[0.0, 0.0], [7.3, 0.0], [7.3, 0.4]])
    points = along(path)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.max() < 2.0
    assert steps.sum() == pytest.approx(7.7)
    assert all((points == corner).all(axis=1).any() for corner in path)


def test_draws_names_with_missing_glyphs_without_warnings():
    """A warning would fail this test, and appear in the user's terminal."""
    with house_style():
        assert as_png(sector_map(replace(x_plus(), name="空域"))).startswith(b"\x89PNG")
