"""Placing texts: none upon another, none beyond the axes, none upon what is drawn."""

from itertools import combinations

import numpy as np

from skystack.reporting.labels import Label, place_labels
from skystack.reporting.style import grid_of_axes, house_style, settle


def boxes_of(labels, drawn):
    with house_style():
        figure, (axes,) = grid_of_axes(1, 1, (5.0, 5.0))
        axes.set(xlim=(-10.0, 10.0), ylim=(-10.0, 10.0))
        settle(figure)
        place_labels(axes, labels, drawn)
        shown = [text for text in axes.texts if text.get_text()]
        boxes = [text.get_window_extent() for text in shown]
        return boxes, axes.get_window_extent(), axes.transData.transform(drawn)


def test_texts_of_one_point_do_not_overlap():
    labels = [Label(f"right {number}", (0.0, 0.0), "black") for number in range(100, 108)]
    boxes, frame, _ = boxes_of(labels, np.zeros((1, 2)))
    assert len(boxes) == len(labels)
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    assert all(frame.containsx(box.x0) and frame.containsx(box.x1) for box in boxes)


def test_texts_stay_inside_at_a_corner_and_off_the_line():
    line = np.stack([np.linspace(-10.0, 10.0, 200)] * 2, axis=-1)
    labels = [Label("left 035", (-9.9, -9.9), "black"), Label("left 045", (9.9, 9.9), "black")]
    boxes, frame, points = boxes_of(labels, line)
    for box in boxes:
        assert frame.count_contains(box.corners()) == 4
        assert box.count_contains(points) == 0


def test_a_lonely_text_stands_close_to_its_point():
    (box,), _, (point,) = boxes_of([Label("EGL", (2.0, 3.0), "black")], np.array([[2.0, 3.0]]))
    gap = np.maximum(np.maximum(box.min - point, point - box.max), 0.0)
    assert 0.0 < np.hypot(*gap) < 12.0
