"""A replay made by hand: two aircraft fly straight towards each other and pass at 3 NM."""

import numpy as np

from skystack.airspace.sectors import sector_named
from skystack.reporting.replay.recording import (
    Loss,
    RecordedAircraft,
    RecordedClearance,
    Replay,
    ReplayScenario,
)

ROWS = 21
KNOTS = 480.0
"""0.8 NM per cycle."""


def straight_flight(callsign, start_nm, heading_deg, rows=ROWS):
    east, north = np.sin(np.radians(heading_deg)), np.cos(np.radians(heading_deg))
    along = KNOTS / 600.0 * np.arange(rows)
    return RecordedAircraft(
        callsign=callsign,
        type="B753",
        route=("HERON", "CRANE", "EGL", "FINCH", "ROBIN"),
        entry_fl=300.0,
        exit_fl=300,
        position_nm=np.asarray(start_nm) + along[:, None] * np.array([east, north]),
        fl=np.full(rows, 300.0),
        heading_deg=np.full(rows, float(heading_deg)),
        cleared_heading_deg=np.full(rows, float(heading_deg)),
        cleared_fl=np.full(rows, 300.0),
        ground_speed_kt=np.full(rows, KNOTS),
        vertical_speed_ft_min=np.zeros(rows),
        status=("in_sector",) * rows,
    )


def replay(title="made", callsigns=("AC1", "AC2"), number=4):
    """The aircraft start 16 NM apart and are closest after ten cycles."""
    one = straight_flight(callsigns[0], (-8.0, 0.0), 90.0)
    other = straight_flight(callsigns[1], (8.0, 3.0), 270.0, rows=ROWS - 3)
    clearances = (
        RecordedClearance(
            0, 2, "heading", 90, "right", 3, f"{callsigns[0]} turn right heading 090"
        ),
        RecordedClearance(1, 12, "heading", 270, None, 1, f"{callsigns[1]} fly heading 270"),
    )
    # Closer than 5 NM while less than 4 NM apart along their tracks: rows 7.5 to 12.5.
    losses = (Loss(0, 1, 7, 13, 3.0),)
    scenario = ReplayScenario(number, ROWS - 1, True, (one, other), clearances, losses)
    return Replay(title, sector_named("x-plus"), (scenario,))
