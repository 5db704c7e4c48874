"""Bins of whole numbers, the paper's mean, common axes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skystack.reporting.histograms import (
    MOST_BINS,
    Nearest,
    Panel,
    bin_edges,
    histogram,
    histograms,
    separations,
)
from skystack.reporting.style import house_style

COUNTS = arrays(np.int32, st.integers(1, 30), elements=st.integers(0, 600))


@given(COUNTS, st.none() | st.floats(0.0, 600.0))
def test_bins_hold_every_count_and_the_papers_mean(counts, paper_mean):
    edges = bin_edges([Panel("", counts, paper_mean)])
    assert np.histogram(counts, edges)[0].sum() == len(counts)
    assert np.all(edges % 1.0 == 0.5)
    assert len(set(np.diff(edges))) == 1
    assert len(edges) <= MOST_BINS + 2
    assert edges[0] < (paper_mean or 0.0) < edges[-1]


def test_titles_and_the_papers_line():
    panel = Panel("Damped", np.array([6, 8], dtype=np.int32), 14.5)
    with house_style():
        (alone,), (among,) = histogram(panel).axes, histograms([panel]).axes
    assert alone.get_xlabel().endswith("\ndashed: the paper's mean, 14.5")
    assert among.get_title(loc="right") == "dashed: the paper's mean, 14.5"
    for axes in (alone, among):
        assert axes.get_title(loc="left") == "Damped: 7.0 ± 1.0"
        assert axes.lines[0].get_xdata() == [14.5, 14.5]


def test_a_row_that_the_paper_lacks_has_no_line():
    with house_style():
        axes = histogram(Panel("Ours", np.array([1], dtype=np.int32), None)).axes[0]
    assert not axes.lines
    assert "dashed" not in axes.get_xlabel()


def test_panels_share_axes_and_bins():
    panels = [Panel(str(most), np.array([0, most], dtype=np.int32), None) for most in (3, 120)]
    with house_style():
        first, second = histograms(panels).axes
    assert first.get_xlim() == second.get_xlim()
    assert first.get_ylim() == second.get_ylim()
    assert len(first.patches) == len(second.patches)


def test_separations_count_losses_and_show_every_scenario():
    nearest = np.array([0.0, 4.999, 5.0, 12.0, 300.0, np.inf])
    with house_style():
        axes = separations([Nearest("Stacked", nearest, 2, 5.0)]).axes[0]
    assert axes.get_title(loc="left") == "Stacked: 2 of 6 below 5 NM"
    assert sum(bar.get_height() for bar in axes.patches) == 6
    assert axes.lines[0].get_xdata() == [5.0, 5.0]


def test_separations_end_where_the_values_do():
    with house_style():
        axes = separations([Nearest("Stacked", np.array([4.0, 27.0]), 1, 5.0)]).axes[0]
    assert axes.get_xlim() == (0.0, 30.0)
    assert axes.get_xlabel() == "minimum separation per scenario, NM"


@pytest.mark.parametrize(("most", "width"), [(0, 1), (79, 1), (80, 2), (159, 2), (160, 3)])
def test_bins_are_as_narrow_as_80_of_them_allow(most, width):
    edges = bin_edges([Panel("", np.array([0, most], dtype=np.int32), None)])
    assert edges[0] == -0.5
    assert set(np.diff(edges)) == {width}
    assert most < edges[-1] <= max(most, 4) + width + 0.5


def test_what_is_far_apart_is_in_the_last_bar_which_says_so():
    """Up to 60 NM in bars of 2.5; the axis is that of the row that comes farthest."""
    panels = [
        Nearest("near", np.array([3.0, 4.0, 8.0]), 2, 5.0),
        Nearest("far", np.array([57.4, 57.6, 60.0, 90.0]), 0, 5.0),
    ]
    with house_style():
        near, far = separations(panels).axes
    assert near.get_xlim() == far.get_xlim() == (0.0, 60.0)
    assert far.get_xlabel() == "minimum separation per scenario, NM (last bar: 57.5 and more)"
    assert [bar.get_height() for bar in far.patches][-2:] == [1, 3]
    assert near.get_title(loc="left") == "near: 2 of 3 below 5 NM"
    with house_style():
        (axes,) = separations([Nearest("", np.array([59.9]), 0, 3.5)]).axes
    assert axes.get_xlabel() == "minimum separation per scenario, NM"
    assert axes.get_title(loc="left") == ": 0 of 1 below 3.5 NM"
