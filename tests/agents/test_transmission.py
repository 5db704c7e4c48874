"""Transmissions as clearances of the simulator."""

import numpy as np

from skystack.agents.transmission import Transmission, clearance_of
from skystack.simulator.traffic import DIRECT, NO_TURN, SHORTEST


def test_one_clearance_for_all_flights():
    clearance = clearance_of(
        [
            Transmission(0, heading_deg=90),
            Transmission(2, fix=3, level_ticks=1_200_000.0),
            Transmission(3, level_ticks=1_800_000.0),
        ],
        slots=5,
    )
    assert clearance.turn.tolist() == [SHORTEST, NO_TURN, DIRECT, NO_TURN, NO_TURN]
    assert float(clearance.heading_deg[0]) == 90.0
    assert int(clearance.fix[2]) == 3
    assert clearance.changes_level.tolist() == [False, False, True, True, False]
    np.testing.assert_array_equal(clearance.level_ticks[2:4], [1_200_000.0, 1_800_000.0])
