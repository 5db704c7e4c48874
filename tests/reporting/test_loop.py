"""The diagram of policy and simulator."""

from skystack.reporting.loop import loop
from skystack.reporting.style import freeze_layout, house_style


def test_diagram_names_components_and_signals():
    with house_style():
        figure = loop()
        freeze_layout(figure)
    (axes,) = figure.axes
    all_text = " ".join(text.get_text().replace("\n", " ") for text in axes.texts)
    for word in ("Policy", "Online action-stacking", "Simulator", "clearance", "reward"):
        assert word in all_text
    frame = axes.get_window_extent()
    boxes = [text.get_window_extent() for text in axes.texts if text.get_text()]
    assert all(frame.count_contains(box.corners()) == 4 for box in boxes)
