"""Between latitude and longitude and the plane in which everything is computed.

The plane touches the WGS-84 ellipsoid at the sector's origin: one constant scale per axis. Over a
sector this keeps distances between aircraft within 0.02 NM of the geodesic.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from pyproj import Geod

METRES_PER_NM = 1852.0
WGS84 = Geod(ellps="WGS84")


@dataclass(frozen=True)
class TangentPlane:
    """A plane of nautical miles, x to the east and y to the north, tangent at an origin."""

    origin_lat_deg: float
    origin_lon_deg: float

    @cached_property
    def scale_nm_per_deg(self) -> Float[np.ndarray, "2"]:
        """NM per degree of longitude (x) and of latitude (y): the radii of curvature at the origin.

        At the equator 60.107716 and 59.705333.
        """
        latitude = math.radians(self.origin_lat_deg)
        squash = 1.0 - WGS84.es * math.sin(latitude) ** 2
        meridian_m = WGS84.a * (1.0 - WGS84.es) / squash**1.5
        parallel_m = WGS84.a / math.sqrt(squash) * math.cos(latitude)
        return np.radians(np.array([parallel_m, meridian_m])) / METRES_PER_NM

    def to_plane(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> Float[np.ndarray, "*shape 2"]:
        """Positions [NM] of points given in degrees; float64."""
        lat = np.asarray(lat_deg, dtype=np.float64)
        lon = np.asarray(lon_deg, dtype=np.float64)
        offset = np.stack([lon - self.origin_lon_deg, lat - self.origin_lat_deg], axis=-1)
        return offset * self.scale_nm_per_deg

    def to_degrees(self, position_nm: ArrayLike) -> Float[np.ndarray, "*shape 2"]:
        """Latitude and longitude (in this order, degrees, float64) of positions in the plane."""
        offset = np.asarray(position_nm, dtype=np.float64) / self.scale_nm_per_deg
        return np.stack(
            [offset[..., 1] + self.origin_lat_deg, offset[..., 0] + self.origin_lon_deg], axis=-1
        )


def geodesic_leg(
    start_deg: tuple[float, float], end_deg: tuple[float, float]
) -> tuple[float, float]:
    """Initial bearing [deg, 0 to 360] and length [NM] of the geodesic between two (lat, lon)."""
    bearing, _, length_m = WGS84.inv(start_deg[1], start_deg[0], end_deg[1], end_deg[0])
    return float(bearing) % 360.0, float(length_m) / METRES_PER_NM
