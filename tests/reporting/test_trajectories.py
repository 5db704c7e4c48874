"""Plan views of a scenario."""

import dataclasses

import numpy as np
import pytest

from skystack.airspace.xplus import x_plus
from skystack.reporting.flights import FlownScenario, IssuedClearance, Track
from skystack.reporting.style import house_style
from skystack.reporting.trajectories import (
    MAX_TEXTS,
    burst_text,
    clearances_text,
    picture,
    pictures,
)


def scenario_of(count, every=10, aircraft=2):
    """Straight flights to the north-east, with clearances to alternating sides."""
    sector = x_plus()
    route = np.array([sector.fixes_nm[name] for name in sector.routes[0]])
    path = np.linspace([-20.0, -20.0], [40.0, 40.0], 60)
    clearances = tuple(
        IssuedClearance(every * number % 60, 0, "heading", 45, ("left", "right")[number % 2], 1, "")
        for number in range(count)
    )
    level = np.full(len(path), 300.0)
    tracks = [
        Track(f"AC{n}", route, path + n, level, level, 300, None, clearances)
        for n in range(aircraft)
    ]
    return FlownScenario(sector, 3, aircraft * count, tuple(tracks))


def texts_of(figure):
    return [text.get_text() for axes in figure.axes for text in axes.texts]


@pytest.mark.parametrize(("count", "text"), [(0, "0 clearances"), (1, "1 clearance")])
def test_text_for_the_number_of_clearances(count, text):
    assert clearances_text(count) == text


def test_text_for_a_burst():
    one = IssuedClearance(0, 0, "heading", 285, "right", 1, "")
    assert burst_text([one]) == "right 285"
    assert burst_text([one._replace(value=275), one]) == "2 clearances to 285"
    assert burst_text([one] * 6 + [one._replace(value=5)]) == "7 clearances to 005"
    climb = one._replace(kind="level", direction="climb", value=340)
    assert burst_text([climb._replace(value=330), climb]) == "2 clearances to FL340"


def test_picture_shows_clearances_callsigns_and_fixes():
    with house_style():
        figure = picture("Damped", scenario_of(2))
    axes = figure.axes[0]
    assert axes.get_title(loc="left") == "Damped: 4 clearances"
    texts = texts_of(figure)
    assert texts.count("left 045") == texts.count("right 045") == 2
    assert {"AC0", "AC1", *x_plus().fixes} <= set(texts)
    assert axes.get_aspect() == 1.0


def test_crowded_picture_has_marks_but_no_texts():
    scenario = scenario_of(MAX_TEXTS, every=1)
    with house_style():
        figure = picture("Undamped", scenario)
    assert "left 045" not in texts_of(figure)
    marks = [line for line in figure.axes[0].lines if len(line.get_xdata()) == MAX_TEXTS]
    assert len(marks) == len(scenario.tracks)


def test_excursions_are_marked_and_in_the_legend():
    scenario = scenario_of(1)
    excursion = dataclasses.replace(scenario.tracks[0], excursion_cycle=5)
    with house_style():
        plain = picture("Damped", scenario)
        marked = picture("Damped", dataclasses.replace(scenario, tracks=(excursion,)))
    assert "excursion" not in [text.get_text() for text in plain.legends[0].get_texts()]
    assert "excursion" in [text.get_text() for text in marked.legends[0].get_texts()]


def test_panels_share_their_limits():
    panels = [(name, scenario_of(1)) for name in ("a", "b", "c")]
    with house_style():
        figure = pictures(panels)
    panel_axes = [axes for axes in figure.axes if axes.axison]
    assert len(panel_axes) == 3
    assert len({(axes.get_xlim(), axes.get_ylim()) for axes in panel_axes}) == 1


def test_minimum_separation_is_a_line_with_its_length():
    scenario = scenario_of(0)
    with house_style():
        plain = picture("Damped", scenario)
        marked = picture("Damped", scenario, separation=True)
    # The second aircraft is 1 NM east and 1 NM north of the first.
    assert "1.4 NM" in texts_of(marked)
    assert "1.4 NM" not in texts_of(plain)
    lines = [line.get_xydata() for line in marked.axes[0].lines if line.get_marker() == "s"]
    assert len(lines) == 1
    np.testing.assert_allclose(lines[0][1] - lines[0][0], [1.0, 1.0])
    assert "minimum separation" in [text.get_text() for text in marked.legends[0].get_texts()]
