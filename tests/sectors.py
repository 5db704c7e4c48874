"""Sectors for several tests."""

from skystack.airspace.sector import Sector

FAR_NORTH = Sector(
    "far north",
    (64.0, 15.0),
    ((60.0, 9.0), (62.0, 21.0), (68.0, 21.0), (67.0, 9.0)),
    (200, 400),
    {
        "WESTO": (65.8, 8.6),
        "WESTE": (65.8, 9.0),
        "EASTE": (65.8, 21.0),
        "EASTO": (65.8, 21.4),
        "SOUTO": (60.5, 15.0),
        "SOUTH": (61.0, 15.0),
    },
    (("WESTO", "WESTE", "EASTE", "EASTO"), ("EASTO", "EASTE", "SOUTH", "SOUTO")),
)
"""From 60 N to 68 N, where a degree of longitude is at most half as long as at the equator."""
