"""Placing texts: they cover neither each other nor the drawing, and stay inside the axes."""

from itertools import combinations

import numpy as np
import pytest

from skystack.reporting.labels import (
    LEADER_FROM_PT,
    PADDING_PT,
    POINTS_PER_INCH,
    Label,
    _crossed,
    _inside,
    _offsets,
    _overlapping,
    place_labels,
)
from skystack.reporting.style import BLUE, PAPER, freeze_layout, grid_of_axes, house_style


def boxes_of(labels, drawn):
    with house_style():
        figure, (axes,) = grid_of_axes(1, 1, (5.0, 5.0))
        axes.set(xlim=(-10.0, 10.0), ylim=(-10.0, 10.0))
        freeze_layout(figure)
        place_labels(axes, labels, drawn)
        texts = [text for text in axes.texts if text.get_text()]
        boxes = [text.get_window_extent() for text in texts]
        return boxes, axes.get_window_extent(), axes.transData.transform(drawn)


def test_texts_at_one_point_do_not_overlap():
    labels = [Label(f"right {number}", (0.0, 0.0), "black") for number in range(100, 108)]
    boxes, frame, _ = boxes_of(labels, np.zeros((1, 2)))
    assert len(boxes) == len(labels)
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    assert all(frame.containsx(box.x0) and frame.containsx(box.x1) for box in boxes)


def test_texts_in_corners_stay_inside_and_off_the_line():
    line = np.stack([np.linspace(-10.0, 10.0, 200)] * 2, axis=-1)
    labels = [Label("left 035", (-9.9, -9.9), "black"), Label("left 045", (9.9, 9.9), "black")]
    boxes, frame, points = boxes_of(labels, line)
    for box in boxes:
        assert frame.count_contains(box.corners()) == 4
        assert box.count_contains(points) == 0


def test_single_text_is_close_to_its_point():
    (box,), _, (point,) = boxes_of([Label("EGL", (2.0, 3.0), "black")], np.array([[2.0, 3.0]]))
    gap = np.maximum(np.maximum(box.min - point, point - box.max), 0.0)
    assert 0.0 < np.hypot(*gap) < 12.0


BOXES = np.array([[[0.0, 0.0], [2.0, 1.0]]])


@pytest.mark.parametrize(
    ("low", "high", "overlaps"),
    [
        ((1.0, 0.5), (3.0, 2.0), True),
        ((0.5, 0.2), (1.0, 0.8), True),  # inside
        ((-1.0, -1.0), (3.0, 2.0), True),  # around it
        ((-1.0, 0.4), (3.0, 0.6), True),  # across it
        ((2.5, 0.0), (3.0, 1.0), False),
        ((-2.0, 0.0), (-0.5, 1.0), False),
        ((0.0, 1.5), (2.0, 2.0), False),
        ((0.0, -2.0), (2.0, -0.5), False),
        ((3.0, 3.0), (4.0, 4.0), False),
    ],
)
def test_boxes_overlap_if_they_do_on_both_axes(low, high, overlaps):
    other = np.array([[low, high]])
    assert _overlapping(BOXES, other).tolist() == [[overlaps]]
    assert _overlapping(other, BOXES).tolist() == [[overlaps]]


def test_points_are_inside_a_box_if_within_both_sides():
    points = np.array([[1.0, 0.5], [2.5, 0.5], [-0.5, 0.5], [1.0, 1.5], [1.0, -0.5], [5.0, 5.0]])
    assert _inside(points, BOXES).tolist() == [[True, False, False, False, False, False]]


def test_counts_texts_that_a_leader_line_crosses():
    """From the origin: east across two boxes, east across one, north, and west."""
    taken = np.array([[[2.0, -1.0], [4.0, 1.0]], [[6.0, -1.0], [8.0, 1.0]]])
    centres = np.array([[10.0, 0.0], [5.0, 0.0], [0.0, 5.0], [-10.0, 0.0]])
    assert _crossed(np.zeros(2), centres, taken).tolist() == [2.0, 1.0, 0.0, 0.0]
    assert _crossed(np.zeros(2), centres, taken[:0]).tolist() == [0.0] * 4


def test_candidates_keep_their_distance_in_all_directions():
    """At each distance, boxes in 24 directions, 15 degrees apart, are exactly that far away."""
    half = np.array([20.0, 5.0])
    offsets = _offsets(half, (5.0, 9.0)).reshape(2, -1, 2)
    for distance, around in zip((5.0, 9.0), offsets, strict=True):
        beyond = np.abs(around) - half
        np.testing.assert_allclose(beyond.max(axis=1), distance)
        angle = np.degrees(np.arctan2(*(around / (half + distance)).T))
        np.testing.assert_allclose(np.diff(np.sort(angle)), 15.0)
        assert len(angle) == 24


def test_text_has_the_given_style_and_a_halo():
    with house_style():
        figure, (axes,) = grid_of_axes(1, 1, (5.0, 5.0))
        freeze_layout(figure)
        label = Label("EGL", (0.5, 0.5), BLUE, size_pt=9.5, weight="bold")
        place_labels(axes, [label], np.zeros((1, 2)))
    (text,) = axes.texts
    assert (text.get_text(), text.xy, text.get_color()) == ("EGL", (0.5, 0.5), BLUE)
    assert (text.get_fontsize(), text.get_fontweight()) == (9.5, "bold")
    assert (text.get_ha(), text.get_va()) == ("center", "center")
    (halo,) = text.get_path_effects()
    assert halo._gc["foreground"] == PAPER
    assert halo._gc["linewidth"] > 0.0


def placed(labels, drawn, limits=((-10.0, 10.0), (-10.0, 10.0))):
    """The offset of each text's centre from its point [pt], half its size, and the leaders."""
    with house_style():
        figure, (axes,) = grid_of_axes(1, 1, (5.0, 5.0))
        axes.set(xlim=limits[0], ylim=limits[1])
        freeze_layout(figure)
        place_labels(axes, labels, np.array(drawn))
        scale = POINTS_PER_INCH / figure.dpi
        boxes = [
            np.array(text.get_window_extent().get_points()) * scale
            for text in axes.texts
            if text.get_text()
        ]
        leaders = [text for text in axes.texts if not text.get_text()]
        anchors = axes.transData.transform([label.point for label in labels]) * scale
    middles = [box.mean(axis=0) - at for box, at in zip(boxes, anchors, strict=True)]
    return middles, [np.ptp(box, axis=0) / 2.0 for box in boxes], leaders


@pytest.mark.parametrize(("distance_pt", "has_line"), [(11.97, False), (12.03, True)])
def test_text_farther_than_12_pt_has_a_leader_line(distance_pt, has_line):
    """The distance is from the point to the nearest place on the padded box."""
    assert LEADER_FROM_PT == 12.0
    label = Label("EGL", (0.0, 0.0), "black", distances_pt=(distance_pt,))
    (middle,), (half,), leaders = placed([label], [[9.0, 9.0]])
    gap = np.maximum(np.abs(middle) - half - PADDING_PT, 0.0)
    # Directly above, below or beside the point; at a corner it would be farther.
    assert sorted(gap) == pytest.approx([0.0, distance_pt], abs=0.3)
    assert len(leaders) == has_line
    for leader in leaders:
        nearest = np.clip(0.0, middle - half - PADDING_PT, middle + half + PADDING_PT)
        assert leader.get_position() == pytest.approx(nearest, abs=0.3)
        assert leader.xy == (0.0, 0.0)


def test_prefers_the_smallest_distance():
    label = Label("EGL", (0.0, 0.0), "black", distances_pt=(23.0, 5.0, 15.0))
    (middle,), (half,), leaders = placed([label], [[9.0, 9.0]])
    assert max(np.abs(middle) - half - PADDING_PT) == pytest.approx(5.0, abs=0.3)
    assert leaders == []


def test_text_goes_where_least_is_drawn():
    """Drawn points surround the text's point, except on one side."""
    angle = np.radians(np.arange(0.0, 360.0, 2.0))
    open_towards = np.abs((np.degrees(angle) + 180.0) % 360.0 - 180.0) > 30.0
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)[open_towards]
    drawn = np.concatenate([radius * circle for radius in np.linspace(0.3, 2.0, 18)])
    (middle,), _, _ = placed([Label("A", (0.0, 0.0), "black", distances_pt=(5.0,))], drawn)
    assert middle[0] > 2.0 * abs(middle[1])


@pytest.mark.parametrize("corner", [(-10.0, -10.0), (-10.0, 10.0), (10.0, -10.0), (10.0, 10.0)])
def test_text_at_a_corner_stays_inside(corner):
    """Even if the inside is full, because being outside costs more."""
    grid = np.stack(np.meshgrid(*[np.linspace(-10.0, 10.0, 60)] * 2), axis=-1).reshape(-1, 2)
    (middle,), _, _ = placed([Label("EGL", corner, "black")], grid)
    assert np.all(middle * np.sign(corner) < 0.0)


def test_first_text_has_priority_and_leaders_cross_no_text():
    """Of three texts at one point, the last must be farther away, on a free side."""
    labels = [Label("0000", (0.0, 0.0), "black", distances_pt=(5.0,)) for _ in range(2)]
    labels.append(Label("1111", (0.0, 0.0), "black", distances_pt=(40.0,)))
    (first, second, third), halves, _ = placed(labels, [[9.0, 9.0]])
    alone = placed(labels[:1], [[9.0, 9.0]])[0][0]
    np.testing.assert_allclose(first, alone)
    for share in np.linspace(0.0, 1.0, 50):
        for middle, half in ((first, halves[0]), (second, halves[1])):
            assert np.any(np.abs(share * third - middle) > half)


def test_text_covers_points_rather_than_another_text():
    """Drawn points surround the point, except on one side, which the first text takes."""
    angle = np.radians(np.arange(40.0, 321.0, 10.0))
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    drawn = np.concatenate([radius * circle for radius in np.linspace(0.3, 2.0, 6)])
    labels = [Label("text", (0.0, 0.0), "black", distances_pt=(5.0,)) for _ in range(2)]
    (first, second), _, points = boxes_of(labels, drawn)
    assert first.count_contains(points) == 0 < second.count_contains(points) < 15
    assert not first.overlaps(second)
