"""Two aircraft that meet head-on, straight, at constant speed: all about them is a formula.

Each flies 400 kt, 2/3 NM a cycle. `AHEAD_NM` lies between them at first along their tracks and
`BESIDE_NM` across, so that after k cycles they are hypot(AHEAD_NM - 4/3 k, BESIDE_NM) apart.
"""

from tests.scenarios import NORTHBOUND

EVIL = "<img src=x onerror=alert(1)>"
"""Were it not taken as text, a browser would obey it."""
AHEAD_NM, BESIDE_NM = 40.2, 3.04
CLOSING_NM = 4 / 3
NM_PER_DEG_LAT, NM_PER_DEG_LON = 59.705333, 60.107716
"""Of the WGS-84 ellipsoid at the equator."""
FIRST_LOSS, LAST_LOSS = 27, 34
"""The rows round |AHEAD_NM - 4/3 k| < 3.97, where the distance is less than 5 NM."""


def meeting(*clearances, levels=(300, 300), cycles=60):
    """A scenario file's content."""
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
