"""Closed forms of means and intervals over trainings and scenarios."""

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skystack.evaluation import statistics
from skystack.evaluation.statistics import (
    MEASURES,
    Bootstrap,
    comparison,
    interquartile_mean,
    mean,
    probability_less,
    row_statistics,
)

FIGURES = arrays(np.float64, st.integers(1, 6), elements=st.integers(0, 5).map(float))


def episodes(values):
    return pa.table({measure: np.asarray(values) for measure in MEASURES})


def test_the_interquartile_mean_leaves_out_the_extremes():
    assert interquartile_mean(np.array([100.0, 1.0, 2.0, 3.0, -50.0])) == pytest.approx(2.0)
    assert interquartile_mean(np.array([1.0, 4.0])) == pytest.approx(2.5)


@given(FIGURES, FIGURES)
def test_probability_less_against_brute_force(first, second):
    won = [(a < b) + 0.5 * (a == b) for a in first for b in second]
    assert probability_less(first, second) == pytest.approx(np.mean(won))
    assert probability_less(first, second) + probability_less(second, first) == pytest.approx(1.0)


def test_one_training_is_as_sure_as_its_scenarios_are_many():
    """The standard error of a rate p is sqrt(p (1 - p) / n)."""
    happened = np.repeat([1.0, 0.0], [300, 700])[None]
    found = Bootstrap(1000).estimate(mean, happened)
    half = 1.96 * np.sqrt(0.3 * 0.7 / 1000)
    assert found.value == pytest.approx(0.3)
    assert found.low == pytest.approx(0.3 - half, abs=0.1 * half)
    assert found.high == pytest.approx(0.3 + half, abs=0.1 * half)


def test_trainings_that_differ_make_the_interval_wide():
    """With no spread between scenarios, only the draw of trainings counts: sd / sqrt(5)."""
    trainings = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    drawn = mean(Bootstrap(50, resamples=20_000).means(np.repeat(trainings[:, None], 50, axis=1)))
    assert drawn.mean() == pytest.approx(3.0, abs=0.02)
    assert drawn.std() == pytest.approx(trainings.std() / np.sqrt(5), rel=0.03)


def test_scenarios_are_drawn_in_common_for_all_trainings():
    """Trainings that agree in every scenario are no surer together than one alone."""
    scenario = np.arange(100.0)
    alone = mean(Bootstrap(100).means(scenario[None])).std()
    together = mean(Bootstrap(100).means(np.tile(scenario, (5, 1)))).std()
    assert together == pytest.approx(alone, rel=0.05)


def test_a_row_whose_scenarios_are_all_alike_is_certain():
    found = row_statistics([episodes([2.0] * 30), episodes([2.0] * 30)])
    assert set(found) == set(MEASURES)
    for measure in found.values():
        assert measure["mean"] == pytest.approx((2.0, 2.0, 2.0))
        assert measure["iqm"] == pytest.approx((2.0, 2.0, 2.0))


def test_a_row_that_is_lower_everywhere_is_lower_for_certain():
    random = np.random.default_rng(1)
    more = [random.integers(5, 9, 200) for _ in range(3)]
    found = comparison(
        [episodes(values - 2) for values in more], [episodes(values) for values in more], "success"
    )
    assert found["probability_less"] == (1.0, 1.0, 1.0)
    assert found["difference"].value == pytest.approx(-2.0)
    assert -2.5 < found["difference"].low <= -2.0 <= found["difference"].high < -1.5


def test_the_same_figures_come_out_each_time():
    rows = [episodes(np.arange(40.0)), episodes(np.arange(40.0)[::-1])]
    assert row_statistics(rows) == row_statistics(rows)


def test_resamples_that_are_drawn_some_at_a_time_are_the_same(monkeypatch):
    values = np.random.default_rng(1).integers(0, 30, (3, 50)).astype(float)
    whole = Bootstrap(50, resamples=40).estimate(mean, values)
    monkeypatch.setattr(statistics, "MOST_AT_ONCE", 350)  # seven resamples
    parts = Bootstrap(50, resamples=40).estimate(mean, values)
    assert parts == pytest.approx(whole, rel=1e-6)
