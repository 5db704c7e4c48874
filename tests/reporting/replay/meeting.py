"""Two aircraft that meet head-on, straight and at constant speed, so that a formula applies.

Each flies 400 kt, 2/3 NM per cycle. They start `AHEAD_NM` apart along their tracks and
`BESIDE_NM` across, so that after k cycles their distance is hypot(AHEAD_NM - 4/3 k, BESIDE_NM).
"""

from tests.scenarios import NORTHBOUND

EVIL = "<img src=x onerror=alert(1)>"
"""A browser would execute this if it were not treated as text."""
AHEAD_NM, BESIDE_NM = 40.2, 3.04
CLOSING_NM = 4 / 3
NM_PER_DEG_LAT, NM_PER_DEG_LON = 59.705333, 60.107716
"""On the WGS-84 ellipsoid at the equator."""
FIRST_LOSS, LAST_LOSS = 27, 34
"""The rows around |AHEAD_NM - 4/3 k| < 3.97, where the distance is less than 5 NM."""


def meeting(*clearances, levels=(300, 300), cycles=60):
    """The content of a scenario file."""
    sides = ((EVIL, -AHEAD_NM / 2, 0.0, 90), ("AC2", AHEAD_NM / 2, BESIDE_NM, 270))
    return {
        "sector": "x-plus",
        "performance": "constant",
        "cycles": cycles,
        "aircraft": [
            {
                "callsign": callsign,
                "route": NORTHBOUND,
                "lat": y_nm / NM_PER_DEG_LAT,
                "lon": x_nm / NM_PER_DEG_LON,
                "heading_deg": heading,
                "fl": fl,
            }
            for (callsign, x_nm, y_nm, heading), fl in zip(sides, levels, strict=True)
        ],
        "clearances": list(clearances),
    }
