"""The loop of policy and simulator."""

from skystack.reporting.loop import loop
from skystack.reporting.style import house_style, settle


def test_what_acts_and_what_is_passed_on_are_named():
    with house_style():
        figure = loop()
        settle(figure)
    (axes,) = figure.axes
    said = " ".join(text.get_text().replace("\n", " ") for text in axes.texts)
    for word in ("Policy", "Online action-stacking", "Simulator", "clearance", "reward"):
        assert word in said
    frame = axes.get_window_extent()
    boxes = [text.get_window_extent() for text in axes.texts if text.get_text()]
    assert all(frame.count_contains(box.corners()) == 4 for box in boxes)
