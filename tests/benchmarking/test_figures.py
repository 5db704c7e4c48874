"""Figures: medians, extremes, and what a rate is of."""

import time

import numpy as np
import pytest

from skystack.benchmarking.figures import Figure, rates
from skystack.benchmarking.peers import PEERS, ratios
from skystack.benchmarking.shown import figures_table


def test_a_figure_has_a_median_and_extremes():
    figure = Figure("jump", "m", (3.0, 1.0, 10.0), "standing")
    assert figure.as_json == {
        "name": "jump",
        "unit": "m",
        "values": (3.0, 1.0, 10.0),
        "configuration": "standing",
        "median": 3.0,
        "least": 1.0,
        "greatest": 10.0,
    }
    (line,) = figures_table([figure]).rows
    assert line == ("jump", "3.00", "1.00 to 10.0", "m", "3")


def test_a_rate_is_amount_by_time_and_the_first_run_does_not_count():
    naps = iter([0.2, 0.02, 0.02, 0.02])
    found = rates(lambda: time.sleep(next(naps)), amount=10.0, repetitions=3)
    assert len(found) == 3
    assert np.median(found) == pytest.approx(10.0 / 0.02, rel=0.3)


def test_ratios_are_of_medians_to_the_peer_with_the_same_work():
    peer = PEERS[0]
    figures = [
        Figure(peer.ours, "steps/s", (90.0, 100.0, 900.0), ""),
        Figure(peer.name, "steps/s", (4.0, 5.0, 6.0), ""),
    ]
    assert ratios(figures) == {peer.name: 20.0}
