"""Capacity and survival curves, against their values."""

import numpy as np

from skystack.reporting.hour_figures import capacity, survival, survival_of
from skystack.reporting.style import house_style
from tests.reporting.rows import hour_row


def test_capacity_curves_have_the_values_of_the_rows():
    rows = [
        ("one", hour_row("one", "60", losses_of_separation=6, flights=1000, correct_exit_rate=0.9)),
        ("one", hour_row("one", "30", losses_of_separation=0, transmissions_per_flight=None)),
        ("one", hour_row("one", "category")),
    ]
    losses, exits, transmissions, lax = capacity(rows).axes
    (line,) = losses.get_lines()
    np.testing.assert_allclose(line.get_xydata(), [[30.0, 0.0], [60.0, 6.0]])
    np.testing.assert_allclose(exits.get_lines()[0].get_xydata(), [[30.0, 98.7], [60.0, 90.0]])
    np.testing.assert_allclose(transmissions.get_lines()[0].get_xydata(), [[60.0, 2.345]])
    assert len(lax.get_lines()[0].get_xydata()) == 2
    assert capacity(rows[2:]) is None


def test_several_seeds_are_averaged():
    rows = [("one", hour_row("one", "60", seed=n, lax_s_mean=1000.0 * n)) for n in (1, 2)]
    lax = capacity(rows).axes[3]
    np.testing.assert_allclose(lax.get_lines()[0].get_xydata(), [[60.0, 1500.0]])


def test_survival_is_the_share_of_hours_without_failure():
    rows = [
        hour_row("one", "60", hours=3.0, lax_s_by_hour=[600.0, 3600.0, 1200.0]),
        hour_row(
            "one", "60", hours=0.5, cycles=300, lax_s_by_hour=[1800.0]
        ),  # short, without a failure
    ]
    expected = [[0.0, 1.0], [600.0, 0.75], [1200.0, 0.5], [1800.0, 0.5], [3600.0, 0.5]]
    np.testing.assert_allclose(survival_of(rows), expected)


def test_a_failure_in_the_last_cycle_ends_survival():
    scores = [600.0, 3600.0, 3600.0]
    row = hour_row("one", "60", lax_s_by_hour=scores, lax_ended_by={"loss": 1, "excursion": 1})
    expected = [[0.0, 1.0], [600.0, 2 / 3], [3600.0, 1 / 3]]
    np.testing.assert_allclose(survival_of([row]), expected)


def test_survival_has_a_panel_for_each_traffic():
    names, kinds = ("one", "other"), ("30", "notebook")
    with house_style():
        figure = survival([(name, hour_row(name, kind)) for name in names for kind in kinds])
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["30 flights/h", "notebook"]
    assert [len(axes.get_lines()) for axes in figure.axes] == [2, 2]


def test_survival_has_a_panel_for_each_simulator():
    flown = [("bluebird", "notebook"), ("skystack", "category"), ("skystack", "notebook")]
    rows = [("one", hour_row("one", kind, platform=platform)) for platform, kind in flown]
    with house_style():
        several, one = survival(rows), survival(rows[:1])
    titles = [axes.get_title(loc="left") for axes in several.axes]
    assert titles == ["category in skystack", "notebook in skystack", "notebook in bluebird"]
    assert [axes.get_title(loc="left") for axes in one.axes] == ["notebook in bluebird"]
