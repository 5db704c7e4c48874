"""Histograms: integer bins, shares of scenarios, the paper's mean, and outliers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skystack.reporting.histograms import (
    MAX_BINS,
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
def test_bins_contain_every_count_and_the_papers_mean(counts, paper_mean):
    """At most 30 counts: none of them is a share of 0.5 % or less."""
    edges = bin_edges(Panel("", counts, paper_mean))
    assert np.histogram(counts, edges)[0].sum() == len(counts)
    assert np.all(edges % 1.0 == 0.5)
    assert len(set(np.diff(edges))) == 1
    assert len(edges) <= MAX_BINS + 2
    assert edges[0] < (paper_mean or 0.0) < edges[-1]


def panel_of(counts, paper_mean=None, title=""):
    return Panel(title, np.array(counts, dtype=np.int32), paper_mean)


def note_of(axes):
    (note,) = axes.texts
    return note.get_text()


def test_shows_titles_and_the_papers_mean():
    panel = panel_of([6, 8], 14.5, "Damped")
    with house_style():
        (single,), (panel_axes, _) = histogram(panel).axes, histograms([panel]).axes
    for axes in (single, panel_axes):
        assert axes.get_title(loc="left") == "Damped: 7.0 ± 1.0"
        assert axes.lines[0].get_xdata() == [14.5, 14.5]
        assert note_of(axes) == "2 scenarios; dashed: paper, 14.5"


def test_no_line_without_a_mean_in_the_paper():
    with house_style():
        axes = histogram(panel_of([1] * 1234)).axes[0]
    assert not axes.lines
    assert note_of(axes) == "1,234 scenarios"


def test_bars_are_shares_of_all_scenarios():
    """Of 1, 1, 2 and 4 clearances, half are 1, a quarter each 2 and 4."""
    panel = panel_of([1, 2, 1, 4])
    with house_style():
        single, several = histogram(panel), histograms([panel])
        for axes in (single.axes[0], several.axes[0]):
            heights = [bar.get_height() for bar in axes.patches]
            assert heights[:5] == [0.0, 50.0, 25.0, 0.0, 25.0]
            assert sum(heights) == 100.0
    assert single.axes[0].get_ylabel() == several.get_supylabel() == "% of scenarios"
    assert single.axes[0].get_xlabel() == several.get_supxlabel() == "clearances per scenario"


def test_each_panel_has_its_own_axes_and_bins():
    """One bar each for 0 to 4 clearances, and for 0 to 39."""
    panels = [panel_of([0, most]) for most in (3, 39)]
    with house_style():
        first, second = histograms(panels).axes
    assert (first.get_xlim()[1], second.get_xlim()[1]) == (4.5, 39.5)
    assert (len(first.patches), len(second.patches)) == (5, 40)


def test_panels_are_in_two_columns():
    """The last row has an empty place if their number is odd."""
    panels = [panel_of([number], title=f"{number}") for number in range(3)]
    with house_style():
        axes = histograms(panels).axes
        places = [each.get_subplotspec() for each in axes]
    assert [(place.rowspan.start, place.colspan.start) for place in places] == [
        *((0, 0), (0, 1)),
        *((1, 0), (1, 1)),
    ]
    assert [each.axison for each in axes] == [True, True, True, False]
    assert [each.get_title(loc="left")[:1] for each in axes] == ["0", "1", "2", ""]


def test_note_is_above_the_bars_and_the_line():
    """The axes reach 1.3 times as high as bars need, and the line ends below the note."""
    with house_style():
        axes = histogram(panel_of([3, 3, 4], 3.5)).axes[0]
    highest = max(bar.get_height() for bar in axes.patches)
    assert axes.get_ylim()[1] >= 1.3 * highest
    assert axes.lines[0].get_ydata()[1] < 0.9
    assert axes.texts[0].get_position()[1] > 0.95


def test_outliers_are_counted_in_the_last_bar():
    """Five of a thousand are 0.5 %. The title is computed over all scenarios."""
    counts = [3] * 500 + [4] * 495 + [1000] * 5
    panel = panel_of(counts)
    assert bin_edges(panel)[-1] < 10.0
    with house_style():
        axes = histogram(panel).axes[0]
    heights = [round(bar.get_height(), 6) for bar in axes.patches]
    assert heights == [0.0, 0.0, 0.0, 50.0, 50.0]
    # (500 * 3 + 495 * 4 + 5 * 1000) / 1000, and the square root of 5012.42 - 8.48^2
    assert axes.get_title(loc="left") == ": 8.5 ± 70.3"
    assert note_of(axes) == "1,000 scenarios, 5 beyond"


@pytest.mark.parametrize(
    ("scenarios", "outliers", "beyond"),
    [(1000, 5, 5), (1000, 6, 0), (200, 1, 1), (199, 1, 0), (100, 1, 0), (10_000, 50, 50)],
)
def test_at_most_half_a_percent_is_beyond_the_last_edge(scenarios, outliers, beyond):
    counts = np.array([2] * (scenarios - outliers) + [700] * outliers, dtype=np.int32)
    edges = bin_edges(Panel("", counts, None))
    assert np.count_nonzero(counts > edges[-1]) == beyond
    with house_style():
        text = note_of(histogram(Panel("", counts, 3.0)).axes[0])
    found = f"{scenarios:,} scenarios" + (f", {beyond} beyond" if beyond else "")
    assert text == f"{found}; dashed: paper, 3.0"


def test_no_outlier_is_left_out_if_the_papers_mean_is_higher():
    counts = np.array([2] * 999 + [90], dtype=np.int32)
    assert bin_edges(Panel("", counts, None))[-1] < 10.0
    assert bin_edges(Panel("", counts, 113.0))[-1] > 113.0
    with house_style():
        assert "beyond" not in note_of(histogram(Panel("", counts, 113.0)).axes[0])


def test_separations_count_losses_and_show_every_scenario():
    nearest = np.array([0.0, 4.999, 5.0, 12.0, 300.0, np.inf])
    with house_style():
        axes = separations([Nearest("Stacked", nearest, 2, 5.0)]).axes[0]
    assert axes.get_title(loc="left") == "Stacked: 2 of 6 below 5 NM"
    assert sum(bar.get_height() for bar in axes.patches) == 6
    assert axes.lines[0].get_xdata() == [5.0, 5.0]


def test_separation_axis_ends_after_the_largest_value():
    with house_style():
        axes = separations([Nearest("Stacked", np.array([4.0, 27.0]), 1, 5.0)]).axes[0]
    assert axes.get_xlim() == (0.0, 30.0)
    assert axes.get_xlabel() == "minimum separation per scenario, NM"


@pytest.mark.parametrize(("most", "width"), [(0, 1), (39, 1), (40, 2), (79, 2), (80, 3)])
def test_bins_are_as_narrow_as_40_bins_allow(most, width):
    edges = bin_edges(panel_of([0, most]))
    assert edges[0] == -0.5
    assert set(np.diff(edges)) == {width}
    assert most < edges[-1] <= max(most, 4) + width + 0.5


def test_last_bar_collects_large_separations():
    """Bars of 2.5 NM up to 60 NM. The row with the largest separation determines the axis."""
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
