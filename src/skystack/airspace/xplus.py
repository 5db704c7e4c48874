"""The X-Plus sector of the paper (section "Airspace"), generated from its parameters.

Four arms meet in the middle: three at right angles and one slanted. A diagonal airway cuts the
corner between two of them. The layout is converted to degrees at 60 NM per degree, as the paper's
authors do, and then projected.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from skystack.airspace.sector import LatLon, Sector, turns_deg

LAYOUT_NM_PER_DEG = 60.0

THROUGH_THE_MIDDLE = {
    "north": ("SWIFT", "QUAIL", "MACAW"),
    "west": ("PEL", "GOOSE", "ALB"),
    "south": ("HERON", "CRANE"),
    "slanted": ("ROBIN", "FINCH"),
}
"""The fixes of each arm from the outside inwards. All arms meet at EGL."""


@dataclass(frozen=True)
class XPlus:
    """Parameters of the sector. Arms are named by their direction before the rotation."""

    half_width_nm: float = 10.0
    """Half the width of each airway."""
    north_arm_nm: float = 60.0
    west_arm_nm: float = 50.0
    south_arm_nm: float = 30.0
    slanted_arm_nm: float = 45.0
    slanted_bearing_deg: float = 60.0
    """Direction of the slanted arm, clockwise from the northern arm."""
    diagonal_half_widths: float = 2.5
    """Distance from the middle to the diagonal's outer edge along the arms, in half widths."""
    outside_nm: float = 5.0
    """Distance of the first and last fix of each route beyond the sector's edge."""
    rotation_deg: float = 45.0
    """Clockwise rotation of the whole layout."""
    levels_fl: tuple[int, int] = (200, 400)
    max_turn_deg: float = 90.0
    """Routes with a sharper turn of the geodesic bearing are excluded."""
    origin: LatLon = (0.0, 0.0)

    def fixes_layout_nm(self) -> dict[str, Float[np.ndarray, "2"]]:
        """The eleven fixes in the rotated layout."""
        slant = math.radians(self.slanted_bearing_deg)
        arms = {
            "QUAIL": (np.array([0.0, 1.0]), self.north_arm_nm, "SWIFT"),
            "GOOSE": (np.array([-1.0, 0.0]), self.west_arm_nm, "PEL"),
            "CRANE": (np.array([0.0, -1.0]), self.south_arm_nm, "HERON"),
            "FINCH": (np.array([math.sin(slant), math.cos(slant)]), self.slanted_arm_nm, "ROBIN"),
        }
        # The diagonal's centreline is half a width inside its outer edge.
        corner = self.half_width_nm * (self.diagonal_half_widths + 1.0 - math.sqrt(2.0))
        points = {
            "EGL": np.zeros(2),
            "ALB": np.array([-corner, 0.0]),
            "MACAW": np.array([0.0, corner]),
        }
        for edge_fix, (unit, length, outer_fix) in arms.items():
            points[edge_fix] = unit * length
            points[outer_fix] = unit * (length + self.outside_nm)
        return {name: self._rotated(point) for name, point in points.items()}

    def area_layout_nm(self) -> Float[np.ndarray, "14 2"]:
        """The vertices of the area in the rotated layout, counter-clockwise."""
        w, cut = self.half_width_nm, self.half_width_nm * self.diagonal_half_widths
        slant = math.radians(self.slanted_bearing_deg)
        along = np.array([math.sin(slant), math.cos(slant)])
        right = w * np.array([math.cos(slant), -math.sin(slant)])
        end = along * self.slanted_arm_nm
        # The slanted arm's two edges meet the eastern edge (x = w) of the north-south airway here.
        joint_right = right + along * (w - right[0]) / along[0]
        joint_left = -right + along * (w + right[0]) / along[0]
        vertices = [
            (-w, -self.south_arm_nm),
            (w, -self.south_arm_nm),
            (w, -w),
            joint_right,
            end + right,
            end - right,
            joint_left,
            (w, self.north_arm_nm),
            (-w, self.north_arm_nm),
            (-w, cut),
            (-cut, w),
            (-self.west_arm_nm, w),
            (-self.west_arm_nm, -w),
            (-w, -w),
        ]
        return np.array([self._rotated(np.array(vertex)) for vertex in vertices])

    def sector(self) -> Sector:
        """The sector with the routes within the turn limit: ten with the default values."""
        fixes = {name: self._degrees(point) for name, point in self.fixes_layout_nm().items()}
        routes = tuple(
            route
            for route in _all_routes()
            if all(abs(turn) <= self.max_turn_deg for turn in turns_deg(route, fixes))
        )
        area = tuple(self._degrees(vertex) for vertex in self.area_layout_nm())
        return Sector("x-plus", self.origin, area, self.levels_fl, fixes, routes)

    def _rotated(self, point: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        turn = math.radians(self.rotation_deg)
        cos, sin = math.cos(turn), math.sin(turn)
        return np.array([cos * point[0] + sin * point[1], cos * point[1] - sin * point[0]])

    def _degrees(self, point: Float[np.ndarray, "2"]) -> LatLon:
        lat, lon = self.origin
        north, east = point[1] / LAYOUT_NM_PER_DEG, point[0] / LAYOUT_NM_PER_DEG
        return float(lat + north), float(lon + east / math.cos(math.radians(lat)))


def _all_routes() -> tuple[tuple[str, ...], ...]:
    """Routes between every two arms through the middle, and both directions of the diagonal."""
    arms = THROUGH_THE_MIDDLE
    through = [
        arms[a] + ("EGL",) + arms[b][::-1] for a in sorted(arms) for b in sorted(arms) if a != b
    ]
    diagonal = [arms["west"] + arms["north"][::-1], arms["north"] + arms["west"][::-1]]
    return tuple(sorted(through + diagonal))


@cache
def x_plus() -> Sector:
    """The paper's sector: ten routes, FL200 to FL400."""
    return XPlus().sector()
