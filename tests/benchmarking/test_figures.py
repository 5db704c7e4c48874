"""Benchmark figures: medians, extremes, rates and ratios."""

import math
from types import SimpleNamespace

from skystack.benchmarking import figures
from skystack.benchmarking.display import figures_table
from skystack.benchmarking.figures import Figure, rates
from skystack.benchmarking.peers import PEERS, ratios


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


def test_json_has_null_for_a_time_that_is_not_finite():
    found = Figure("jump", "s", (3.0, math.inf), "standing").as_json
    assert found["values"] == (3.0, None)
    assert (found["median"], found["least"], found["greatest"]) == (None, 3.0, None)


def test_rates_are_amount_per_time_without_the_first_run(monkeypatch):
    durations_s, clock = iter([8.0, 0.5, 0.25, 2.0]), [0.0]

    def work():
        clock[0] += next(durations_s)

    monkeypatch.setattr(figures, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    assert tuple(rates(work, amount=10.0, repetitions=3)) == (20.0, 40.0, 5.0)


def test_ratios_compare_medians_of_peers_with_the_same_work():
    peer = PEERS[0]
    measured = [
        Figure(peer.ours, "steps/s", (90.0, 100.0, 900.0), ""),
        Figure(peer.name, "steps/s", (4.0, 5.0, 6.0), ""),
    ]
    assert ratios(measured) == {peer.name: 20.0}
