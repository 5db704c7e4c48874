"""Conversion between latitude and longitude and the plane that is used for all computations.

The plane is the ellipsoidal Mercator projection (WGS 84), scaled to 1 at the sector's origin. It is
conformal and its north is true north everywhere, so headings, tracks and turns are exact. Lengths
are not: a plane length is the true length times the local scale, which depends only on y.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import Chebyshev
from numpy.typing import ArrayLike
from pyproj import Geod, Proj

METRES_PER_NM = 1852.0
WGS84 = Geod(ellps="WGS84")

MAX_LATITUDE_DEG = 75.0
"""Sectors must be between 75 S and 75 N. Closer to the poles the scale changes too fast for the
required accuracy."""
SCALE_RANGE_NM = 800.0
"""The local scale is a polynomial in y within this many plane NM north and south of the origin, and
constant beyond. This is twice the maximum distance of a sector's points from its origin; for an
origin at 75 N it reaches 83.6 N."""
SCALE_ERROR = 2e-8
"""The maximum error of that polynomial; float32 resolves 6e-8."""

Values = TypeVar("Values", np.ndarray, Array)


def wrap_longitude(lon_deg: ArrayLike) -> Float[np.ndarray, "*n"]:
    """The same longitude in [-180, 180)."""
    lon = np.asarray(lon_deg, dtype=np.float64)
    inside = (lon >= -180.0) & (lon < 180.0)
    wrapped = np.mod(lon + 180.0, 360.0) - 180.0
    return np.where(inside, lon, np.where(wrapped >= 180.0, -180.0, wrapped))


@dataclass(frozen=True)
class LocalScale:
    """The scale of the plane as a function of y, for numpy and JAX arrays."""

    coefficients: tuple[float, ...]
    """Coefficients of a polynomial in y / `SCALE_RANGE_NM`, the constant term first."""

    def __call__(self, y_nm: Values) -> Values:
        """Plane length per true length at plane coordinate y [NM]."""
        return _polynomial(self.coefficients, y_nm)

    def slope(self, y_nm: Values) -> Values:
        """The derivative of the scale with respect to y [1/NM]."""
        powers = enumerate(self.coefficients[1:], start=1)
        slope = tuple(power * each / SCALE_RANGE_NM for power, each in powers)
        return _polynomial(slope, y_nm)


def _polynomial(coefficients: tuple[float, ...], y_nm: Values) -> Values:
    reduced = y_nm.clip(-SCALE_RANGE_NM, SCALE_RANGE_NM) / SCALE_RANGE_NM
    value = reduced * 0.0 + coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = value * reduced + coefficient
    return value


@dataclass(frozen=True)
class MercatorPlane:
    """A plane in nautical miles, with x to the east and y to the north of an origin."""

    origin_lat_deg: float
    origin_lon_deg: float

    @cached_property
    def _projection(self) -> Proj:
        latitude, longitude = self.origin_lat_deg, self.origin_lon_deg
        return Proj(proj="merc", ellps="WGS84", lat_ts=latitude, lon_0=longitude)

    @cached_property
    def _origin_m(self) -> float:
        """Distance [m] of the origin from the equator in the plane."""
        return float(self._projection(self.origin_lon_deg, self.origin_lat_deg)[1])

    def to_plane(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> Float[np.ndarray, "*shape 2"]:
        """Plane positions [NM] of points in degrees; float64.

        Longitudes are relative to the origin, the shorter way around the earth.
        """
        lat, lon = np.broadcast_arrays(
            np.asarray(lat_deg, dtype=np.float64), np.asarray(lon_deg, dtype=np.float64)
        )
        x, y = self._projection(lon, lat)
        return np.stack([x, np.asarray(y) - self._origin_m], axis=-1) / METRES_PER_NM

    def to_degrees(self, position_nm: ArrayLike) -> Float[np.ndarray, "*shape 2"]:
        """Latitude and longitude [deg], in this order, of positions in the plane; float64.

        Longitudes are in [-180, 180).
        """
        metres = np.asarray(position_nm, dtype=np.float64) * METRES_PER_NM
        lon, lat = self._projection(metres[..., 0], metres[..., 1] + self._origin_m, inverse=True)
        return np.stack([np.asarray(lat), wrap_longitude(lon)], axis=-1)

    @cached_property
    def scale(self) -> LocalScale:
        """The local scale, 1 at the origin."""

        def exact(reduced: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
            y_nm = reduced * SCALE_RANGE_NM
            latitude = np.radians(self.to_degrees(np.stack([np.zeros_like(y_nm), y_nm], -1))[:, 0])
            return _parallel_nm(math.radians(self.origin_lat_deg)) / _parallel_nm(latitude)

        samples = np.linspace(-1.0, 1.0, 257)
        for degree in range(2, 20):
            fitted = Chebyshev.interpolate(exact, degree)
            if float(np.max(np.abs(fitted(samples) - exact(samples)))) < SCALE_ERROR:
                break
        return LocalScale(tuple(fitted.convert(kind=np.polynomial.Polynomial).coef.tolist()))

    @cached_property
    def _sphere(self) -> tuple[float, float]:
        """(Plane NM per radian of longitude, isometric latitude of the origin) on Gauss's sphere.

        This is the conformal sphere that best fits the ellipsoid at the origin. Its Mercator plane
        is the same, and geodesics of the ellipsoid are great circles on it within 0.0015 NM over
        700 NM.
        """
        latitude = math.radians(self.origin_lat_deg)
        squared = WGS84.es
        alpha = math.sqrt(1.0 + squared * math.cos(latitude) ** 4 / (1.0 - squared))
        isometric = math.atanh(math.sin(latitude) / alpha)
        return float(_parallel_nm(latitude)) / alpha, isometric

    def geodesic_direction(
        self, position_nm: Float[Array, "n 2 *batch"], target_nm: Float[Array, "n 2 *batch"]
    ) -> Float[Array, "n 2 *batch"]:
        """The initial direction (east, north) of the geodesic from a position to a target.

        The vector is not normalised. The straight line in the plane would be a rhumb line, which is
        longer. Uses spherical trigonometry in isometric latitudes, without cancellation at short
        range.
        """
        radian_nm, origin = self._sphere
        offset = (target_nm - position_nm) / radian_nm
        sine = jnp.tanh(origin + position_nm[:, 1] / radian_nm)
        bend = 2.0 * (jnp.sinh(offset[:, 1] / 2.0) ** 2 + jnp.sin(offset[:, 0] / 2.0) ** 2)
        east, north = jnp.sin(offset[:, 0]), jnp.sinh(offset[:, 1]) + sine * bend
        return jnp.stack([east, north], axis=1)

    def densified(
        self, start_deg: tuple[float, float], end_deg: tuple[float, float], within_nm: float
    ) -> Float[np.ndarray, "points 2"]:
        """Plane points [NM] along an edge that is straight in longitude and latitude (RFC 7946).

        There are enough points that the straight pieces between them stay within `within_nm` of the
        edge. Both ends are included.
        """
        span = np.array(end_deg) - np.array(start_deg)
        span[1] = float(wrap_longitude(span[1]))
        for pieces in 2 ** np.arange(9):
            fraction = np.linspace(0.0, 1.0, 2 * int(pieces) + 1)[:, None]
            lat, lon = (np.array(start_deg) + fraction * span).T
            points = self.to_plane(lat, lon)
            piece, middle = points[2::2] - points[:-2:2], points[1::2] - points[:-2:2]
            across = piece[:, 0] * middle[:, 1] - piece[:, 1] * middle[:, 0]
            if np.all(np.abs(across) <= within_nm * np.hypot(*piece.T)):
                break
        return points[::2]


def _parallel_nm(latitude: ArrayLike) -> Float[np.ndarray, "*n"]:
    """Length [NM] of one radian of longitude at a latitude [rad]."""
    squash = 1.0 - WGS84.es * np.sin(latitude) ** 2
    return np.asarray(WGS84.a / np.sqrt(squash) * np.cos(latitude) / METRES_PER_NM)


def geodesic_leg(
    start_deg: tuple[float, float], end_deg: tuple[float, float]
) -> tuple[float, float]:
    """Initial bearing [deg, 0 to 360] and length [NM] of the geodesic between two (lat, lon)."""
    bearing, _, length_m = WGS84.inv(start_deg[1], start_deg[0], end_deg[1], end_deg[0])
    return float(bearing) % 360.0, float(length_m) / METRES_PER_NM
