"""Learning curves: smoothing, means over seeds, and what is drawn."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from skystack.reporting.learning_curves import (
    at_the_end,
    convergence,
    learning_curves,
    mean_over_seeds,
    overlaid_curves,
    running_mean,
    steps_until,
    success_curves,
)
from skystack.reporting.results import Update
from skystack.reporting.style import house_style


@given(st.integers(1, 400), st.floats(-1e3, 1e3))
def test_running_mean_preserves_constants(length, value):
    np.testing.assert_allclose(
        running_mean(np.full(length, value), np.ones(length)), value, atol=1e-9
    )


def test_running_mean_preserves_lines_and_ignores_nan():
    line, ones = np.arange(200.0), np.ones(200)
    np.testing.assert_allclose(running_mean(line, ones)[10:-10], line[10:-10])
    holes = np.where(line % 5 == 0, np.nan, 7.0)
    np.testing.assert_allclose(running_mean(holes, ones), holes)


def test_running_mean_is_weighted_by_scenarios():
    values, weights = np.zeros(60), np.ones(60)
    values[30], weights[30] = 1.0, 8.0
    np.testing.assert_allclose(running_mean(values, weights)[28:33], [0.0, 0.8, 0.8, 0.8, 0.0])
    weights[30] = 0.0
    assert np.nansum(running_mean(values, weights)) == 0.0


def test_mean_over_seeds_ends_with_the_shortest_curve():
    long, short = np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.0, 3.0])
    steps, mean = mean_over_seeds([(long, long), (short, 3.0 * short)])
    np.testing.assert_allclose(steps, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(mean, 2.0 * steps)


def updates(success, excursion):
    return [
        Update(
            steps=100 * number,
            episode_return=1.0,
            success=success,
            excursion=excursion,
            episodes=9.0,
        )
        for number in range(1, 5)
    ]


def curve(axes, label):
    return next(line for line in axes.lines if line.get_label() == label).get_ydata()


def test_draws_seeds_as_lines_and_the_rate_of_no_excursion():
    seeds = [updates(0.25, 0.1), updates(0.75, 0.3)]
    with house_style():
        returns, rates, counts = learning_curves("Damped", seeds).axes
    assert len(returns.lines) == 3
    np.testing.assert_allclose(curve(rates, "success"), 0.5)
    np.testing.assert_allclose(curve(rates, "no excursion"), 0.8)
    # Instructions are unknown: no curve, and no error.
    assert "instructions" not in [line.get_label() for line in counts.lines]


def test_experiments_share_one_figure():
    curves = {"Damped": [updates(0.2, None)], "Ours": [updates(0.9, None)]}
    with house_style():
        (axes,) = success_curves(curves).axes
    np.testing.assert_allclose(curve(axes, "Damped"), 0.2)
    np.testing.assert_allclose(curve(axes, "Ours"), 0.9)


def test_overlays_runs_with_one_panel_per_measure():
    runs = {"before": [updates(0.2, None)], "after": [updates(0.9, None), updates(0.7, None)]}
    with house_style():
        figure = overlaid_curves(runs)
    returns, rates, counts = figure.axes
    np.testing.assert_allclose(curve(rates, "before"), 0.2)
    np.testing.assert_allclose(curve(rates, "after"), 0.8)
    np.testing.assert_allclose(curve(returns, "after"), 1.0)
    assert "before" not in [line.get_label() for line in counts.lines]  # unknown
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["before", "after"]


def test_final_value_is_the_end_of_the_running_mean():
    rising = [Update(steps=n, success=n / 100.0, episodes=1.0) for n in range(101)]
    # At the end, three updates of the window of five remain.
    np.testing.assert_allclose(at_the_end(rising, "success"), 0.99)
    unknown = Update(steps=101)
    np.testing.assert_allclose(at_the_end([*rising, unknown], "success"), 0.99)
    assert at_the_end(rising, "instructions") is None


def test_steps_until_success_use_the_mean_over_seeds():
    seeds = [updates(0.7, None), updates(0.9, None)]
    assert steps_until(0.75, seeds) == 100.0
    assert steps_until(0.85, seeds) is None
    assert steps_until(0.5, [updates(None, None)]) is None


def test_convergence_panels_share_axes_and_show_all_criteria():
    learned = [
        Update(steps=1_000_000 * n, success=0.4 * n, few_instructions=0.4 * n, episodes=9.0)
        for n in (1, 2)
    ]
    curves = {"5 actions": [learned], "37 actions": [updates(0.1, 0.3)]}
    with house_style():
        figure = convergence(curves)
    first, second, rates, slow = figure.axes
    assert (first.get_ylim(), rates.get_xlim()) == (second.get_ylim(), slow.get_xlim())
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "5 actions",
        "37 actions",
        "80% success first at 2 million steps",
        "success stays below 80%",
    ]
    np.testing.assert_allclose(curve(rates, "few instructions"), curve(rates, "success"))
    np.testing.assert_allclose(curve(slow, "no excursion"), 0.7)
