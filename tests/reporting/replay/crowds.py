"""Replays made by hand for the controls: many pairs that lose separation, and failures."""

from dataclasses import replace

import numpy as np

from skystack.reporting.replay.outcome import Failure
from skystack.reporting.replay.page import page_data, render
from skystack.reporting.replay.recording import Loss

from .made import ROWS, replay, straight_flight

IN_LOSS = 9
"""Aircraft that fly side by side, less than 5 NM apart."""


def crowd():
    """Nine aircraft in losses of separation from row 3 on: all 36 pairs."""
    aircraft = tuple(
        straight_flight(f"SKY{100 + number}", (0.3 * number, 0.0), 90.0)
        for number in range(IN_LOSS)
    )
    losses = tuple(
        Loss(first, second, 2, ROWS - 1, 0.3 * (second - first))
        for second in range(IN_LOSS)
        for first in range(second)
    )
    (scenario,) = (made := replay("crowd")).scenarios
    crowded = replace(scenario, aircraft=aircraft, losses=losses, clearances=())
    return replace(made, scenarios=(crowded,))


def outcomes():
    """Scenario 0 fails for two reasons and with a loss, 1 succeeds with one, 2 without."""
    (scenario,) = (made := replay("outcomes", callsigns=("=1+1", "AC2"))).scenarios
    failures = (Failure("excursion", (0,)), Failure("too_many_clearances", (0, 1)))
    exited = replace(
        scenario.aircraft[1],
        status=("in_sector",) * (ROWS - 4) + ("exited",),
        exit_offset_nm=0.42,
        cleared_fl=np.full(ROWS - 3, 300.0),
    )
    flown = (
        replace(scenario, number=0, success=False, failures=failures),
        replace(scenario, number=1, aircraft=(scenario.aircraft[0], exited)),
        replace(scenario, number=2, losses=()),
    )
    return replace(made, scenarios=flown)


def write_page(path, *replays):
    path.write_text(render(page_data(replays), "a page"))
    return path
