"""Flights anywhere on the earth against pyproj's geodesics, second by second."""

from dataclasses import replace

import numpy as np
import pytest

from skystack.airspace.projection import METRES_PER_NM, WGS84
from skystack.airspace.xplus import x_plus

from .flights import Flights, TimedClearance, angle_between_deg, geodesic_nm

CYCLES = 300
ORIGINS = {
    "equator": (0.0, 0.0),
    "the Alps": (46.0, 8.0),
    "65 N": (65.0, 15.0),
    "75 N": (75.0, -40.0),
    "Tasmania": (-41.0, 147.0),
    "Fiji, east of the antimeridian": (-17.7, -179.8),
    "Fiji, west of the antimeridian": (-17.7, 179.9),
}
HEADINGS_DEG = np.array([0.0, 45.0, 90.0, 137.0, 225.0, 270.0, 333.0])


def fly_across(origin, cycles=CYCLES, clearances=(), distance_nm=230.0):
    """Aircraft that start on one side of the origin and fly over it; `[row, aircraft]`."""
    sector = replace(x_plus(), origin=origin)
    simulation = Flights(sector, "constant")
    count = len(HEADINGS_DEG)
    back = (HEADINGS_DEG + 180.0) % 360.0
    away = np.full(count, min(distance_nm, 60.0 * (78.0 - abs(origin[0]))) * METRES_PER_NM)
    lat, lon = np.full(count, origin[0]), np.full(count, origin[1])
    lon, lat, _ = WGS84.fwd(lon, lat, back, away)
    start = sector.plane.to_plane(lat, lon)
    rows = simulation.fly(simulation.start(start, HEADINGS_DEG), cycles, clearances)
    return rows, sector.plane.to_degrees(rows.position_nm)


def geodesic_steps(lat_lon, heading_deg, speed_kt):
    """Positions after each second on headings `[seconds, aircraft]`, by pyproj."""
    lat, lon = lat_lon.T
    positions = [lat_lon]
    for heading in heading_deg:
        lon, lat, _ = WGS84.fwd(lon, lat, heading, np.full(len(lat), speed_kt / 3600.0 * 1852.0))
        positions.append(np.stack([lat, lon], axis=-1))
    return np.array(positions)


@pytest.mark.slow
@pytest.mark.parametrize("place", ORIGINS)
def test_constant_headings_agree_with_geodesics(place):
    rows, lat_lon = fly_across(ORIGINS[place])
    exact = geodesic_steps(lat_lon[0], np.tile(HEADINGS_DEG, (6 * CYCLES, 1)), 400.0)[::6]
    assert geodesic_nm(lat_lon, exact).max() < (0.02 if place == "75 N" else 0.01)
    assert np.array_equal(rows.heading_deg[-1], HEADINGS_DEG.astype(np.float32))


@pytest.mark.parametrize("place", ORIGINS)
def test_turns_agree_with_geodesics(place):
    """Turns of 170 degrees to the right after the first cycle, with midpoint headings."""
    clearances = [
        TimedClearance(0, n, heading_deg=(h + 170.0) % 360.0) for n, h in enumerate(HEADINGS_DEG)
    ]
    _, lat_lon = fly_across(ORIGINS[place], 60, clearances, distance_nm=100.0)
    turned = np.clip(1.5 * (np.arange(1, 361) - 6) - 0.75, 0.0, 170.0)
    turned[np.arange(1, 361) > 6 + 114] = 170.0
    turned[5 + 114] = 170.0 - (170.0 - 1.5 * 113) / 2.0
    heading = HEADINGS_DEG[None] + turned[:, None]
    exact = geodesic_steps(lat_lon[0], heading % 360.0, 400.0)[::6]
    assert geodesic_nm(lat_lon, exact).max() < 0.002


@pytest.mark.parametrize("place", ORIGINS)
def test_reported_ground_speed_and_heading_are_true(place):
    rows, lat_lon = fly_across(ORIGINS[place])
    before, after = lat_lon[:-1], lat_lon[1:]
    track, _, metres = WGS84.inv(before[..., 1], before[..., 0], after[..., 1], after[..., 0])
    speed_kt = metres / METRES_PER_NM * 600.0
    assert speed_kt == pytest.approx(rows.ground_speed_kt[1:], abs=0.03)
    assert angle_between_deg(track, HEADINGS_DEG).max() < 0.05


@pytest.mark.parametrize("place", ORIGINS)
def test_longitudes_are_wrapped(place):
    _, lat_lon = fly_across(ORIGINS[place])
    assert np.all((lat_lon[..., 1] >= -180.0) & (lat_lon[..., 1] < 180.0))
