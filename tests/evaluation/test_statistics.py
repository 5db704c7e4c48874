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


def test_an_interval_leaves_out_a_fortieth_of_the_resamples_at_either_end():
    """Of 2,000, 50 each: counted in the resamples of another bootstrap, which are the same."""
    row = np.random.default_rng(3).normal(size=(1, 40))
    found, drawn = Bootstrap(40).estimate(mean, row), mean(Bootstrap(40).means(row))
    assert len(drawn) == 2000
    assert found.value == pytest.approx(row.mean())
    assert (np.sum(drawn < found.low), np.sum(drawn > found.high)) == (50, 50)


def test_each_measure_is_its_own_column():
    """And of a row without any spread, mean and interquartile mean are taken over trainings."""
    of_training = [
        pa.table({measure: [10.0 * place + each] * 4 for place, measure in enumerate(MEASURES)})
        for each in (0.0, 1.0, 2.0, 9.0)
    ]
    found = row_statistics(of_training)
    for place, measure in enumerate(MEASURES):
        assert found[measure]["mean"].value == pytest.approx(10.0 * place + 3.0)
        assert found[measure]["iqm"].value == pytest.approx(10.0 * place + 1.5)
        assert found[measure]["mean"].low < 10.0 * place + 2.0 < found[measure]["mean"].high


def test_a_difference_is_the_first_less_the_second():
    """Over trainings and scenarios together; equal trainings count half."""
    first, second = [episodes([1.0, 3.0]), episodes([3.0, 5.0])], [episodes([3.0, 1.0])]
    found = comparison(first, second, "clearances")
    assert found["difference"].value == pytest.approx(3.0 - 2.0)
    assert found["probability_less"].value == pytest.approx(0.25)


def test_every_scenario_is_as_likely_to_be_drawn():
    """With a value in one scenario alone, a resample's mean is how often that was drawn."""
    for scenario in (0, 1, 2):
        row = np.zeros((1, 3))
        row[0, scenario] = 3.0
        drawn = Bootstrap(3, resamples=20_000).means(row)[:, 0]
        assert drawn.mean() == pytest.approx(1.0, abs=0.03)
        # Three draws of one in three: none in 8 of 27, all in one of 27.
        assert np.mean(drawn == 0.0) == pytest.approx(8 / 27, abs=0.015)
        assert np.mean(drawn > 2.5) == pytest.approx(1 / 27, abs=0.01)


def test_another_seed_draws_other_resamples():
    row = np.arange(20.0)[None]
    means = [Bootstrap(20, seed=seed).means(row) for seed in (0, 0, 1)]
    np.testing.assert_array_equal(means[0], means[1])
    assert not np.array_equal(means[0], means[2])


def test_resamples_that_are_drawn_some_at_a_time_are_the_same(monkeypatch):
    values = np.random.default_rng(1).integers(0, 30, (3, 50)).astype(float)
    whole = Bootstrap(50, resamples=40).estimate(mean, values)
    monkeypatch.setattr(statistics, "MOST_AT_ONCE", 350)  # seven resamples
    parts = Bootstrap(50, resamples=40).estimate(mean, values)
    assert parts == pytest.approx(whole, rel=1e-6)
