"""Means and intervals over trainings and scenarios, against closed forms."""

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

VALUES = arrays(np.float64, st.integers(1, 6), elements=st.integers(0, 5).map(float))


def episodes(values):
    return pa.table({measure: np.asarray(values) for measure in MEASURES})


def test_interquartile_mean_omits_the_extremes():
    assert interquartile_mean(np.array([100.0, 1.0, 2.0, 3.0, -50.0])) == pytest.approx(2.0)
    assert interquartile_mean(np.array([1.0, 4.0])) == pytest.approx(2.5)


@given(VALUES, VALUES)
def test_probability_less_agrees_with_brute_force(first, second):
    wins = [(a < b) + 0.5 * (a == b) for a in first for b in second]
    assert probability_less(first, second) == pytest.approx(np.mean(wins))
    assert probability_less(first, second) + probability_less(second, first) == pytest.approx(1.0)


def test_interval_of_a_rate_agrees_with_its_standard_error():
    """The standard error of a rate p is sqrt(p (1 - p) / n)."""
    outcomes = np.repeat([1.0, 0.0], [300, 700])[None]
    found = Bootstrap(1000).estimate(mean, outcomes)
    half = 1.96 * np.sqrt(0.3 * 0.7 / 1000)
    assert found.value == pytest.approx(0.3)
    assert found.low == pytest.approx(0.3 - half, abs=0.1 * half)
    assert found.high == pytest.approx(0.3 + half, abs=0.1 * half)


def test_spread_of_trainings_widens_the_interval():
    """Without spread between scenarios, the standard error is that of trainings: sd / sqrt(5)."""
    trainings = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    drawn = mean(Bootstrap(50, resamples=20_000).means(np.repeat(trainings[:, None], 50, axis=1)))
    assert drawn.mean() == pytest.approx(3.0, abs=0.02)
    assert drawn.std() == pytest.approx(trainings.std() / np.sqrt(5), rel=0.03)


def test_all_trainings_share_the_drawn_scenarios():
    """Trainings that agree in every scenario have the same standard error as one alone."""
    scenario = np.arange(100.0)
    alone = mean(Bootstrap(100).means(scenario[None])).std()
    together = mean(Bootstrap(100).means(np.tile(scenario, (5, 1)))).std()
    assert together == pytest.approx(alone, rel=0.05)


def test_identical_scenarios_give_an_interval_of_zero_width():
    found = row_statistics([episodes([2.0] * 30), episodes([2.0] * 30)])
    assert set(found) == set(MEASURES)
    for measure in found.values():
        assert measure["mean"] == pytest.approx((2.0, 2.0, 2.0))
        assert measure["iqm"] == pytest.approx((2.0, 2.0, 2.0))


def test_probability_is_1_for_a_row_that_is_lower_everywhere():
    random = np.random.default_rng(1)
    higher = [random.integers(5, 9, 200) for _ in range(3)]
    found = comparison(
        [episodes(values - 2) for values in higher],
        [episodes(values) for values in higher],
        "success",
    )
    assert found["probability_less"] == (1.0, 1.0, 1.0)
    assert found["difference"].value == pytest.approx(-2.0)
    assert -2.5 < found["difference"].low <= -2.0 <= found["difference"].high < -1.5


def test_statistics_are_reproducible():
    rows = [episodes(np.arange(40.0)), episodes(np.arange(40.0)[::-1])]
    assert row_statistics(rows) == row_statistics(rows)


def test_an_interval_excludes_2_5_percent_at_each_end():
    """50 of 2,000, counted in a second bootstrap, which draws the same resamples."""
    row = np.random.default_rng(3).normal(size=(1, 40))
    found, drawn = Bootstrap(40).estimate(mean, row), mean(Bootstrap(40).means(row))
    assert len(drawn) == 2000
    assert found.value == pytest.approx(row.mean())
    assert (np.sum(drawn < found.low), np.sum(drawn > found.high)) == (50, 50)


def test_each_measure_is_computed_from_its_own_column():
    """Without spread between scenarios, both means are means over trainings."""
    trainings = [
        pa.table({measure: [10.0 * index + each] * 4 for index, measure in enumerate(MEASURES)})
        for each in (0.0, 1.0, 2.0, 9.0)
    ]
    found = row_statistics(trainings)
    for index, measure in enumerate(MEASURES):
        assert found[measure]["mean"].value == pytest.approx(10.0 * index + 3.0)
        assert found[measure]["iqm"].value == pytest.approx(10.0 * index + 1.5)
        assert found[measure]["mean"].low < 10.0 * index + 2.0 < found[measure]["mean"].high


def test_difference_is_the_first_minus_the_second():
    """Of means over trainings and scenarios; equal trainings count half."""
    first, second = [episodes([1.0, 3.0]), episodes([3.0, 5.0])], [episodes([3.0, 1.0])]
    found = comparison(first, second, "clearances")
    assert found["difference"].value == pytest.approx(3.0 - 2.0)
    assert found["probability_less"].value == pytest.approx(0.25)


def test_all_scenarios_are_equally_likely_to_be_drawn():
    """Only one scenario is not 0: the mean of a resample is how often it was drawn."""
    for scenario in (0, 1, 2):
        row = np.zeros((1, 3))
        row[0, scenario] = 3.0
        drawn = Bootstrap(3, resamples=20_000).means(row)[:, 0]
        assert drawn.mean() == pytest.approx(1.0, abs=0.03)
        # Of three draws with probability 1/3: none with 8/27, all with 1/27.
        assert np.mean(drawn == 0.0) == pytest.approx(8 / 27, abs=0.015)
        assert np.mean(drawn > 2.5) == pytest.approx(1 / 27, abs=0.01)


def test_resamples_depend_on_the_seed():
    row = np.arange(20.0)[None]
    means = [Bootstrap(20, seed=seed).means(row) for seed in (0, 0, 1)]
    np.testing.assert_array_equal(means[0], means[1])
    assert not np.array_equal(means[0], means[2])


def test_resamples_do_not_depend_on_the_batch_size(monkeypatch):
    values = np.random.default_rng(1).integers(0, 30, (3, 50)).astype(float)
    whole = Bootstrap(50, resamples=40).estimate(mean, values)
    monkeypatch.setattr(statistics, "MAX_AT_ONCE", 350)  # seven resamples at a time
    parts = Bootstrap(50, resamples=40).estimate(mean, values)
    assert parts == pytest.approx(whole, rel=1e-6)
