"""The colours, settings and files of figures."""

import xml.etree.ElementTree as ET

import matplotlib as mpl

from skystack.reporting.style import (
    BLUE,
    DARK_COLOURS,
    grid_of_axes,
    house_style,
    save,
    with_dark_colours,
)


def draw(folder):
    with house_style():
        figure, (axes,) = grid_of_axes(1, 1, (2.0, 2.0))
        axes.plot([0.0, 1.0], [0.0, 1.0 / 3.0], color=BLUE)
        axes.set_title("$5 < 6$ & so on")
        return save(figure, folder / "a.name")


def test_caller_settings_are_neither_used_nor_changed(tmp_path):
    (tmp_path / "other").mkdir()
    first = [path.read_bytes() for path in draw(tmp_path)]
    with mpl.rc_context({"lines.linewidth": 9.0, "font.size": 30.0}):
        before = dict(mpl.rcParams)
        second = [path.read_bytes() for path in draw(tmp_path / "other")]
        assert dict(mpl.rcParams) == before
    assert first == second


def test_file_names_may_contain_dots(tmp_path):
    assert [path.name for path in draw(tmp_path)] == ["a.name.png", "a.name.svg"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.name.png", "a.name.svg"]


def test_svg_follows_the_colour_scheme_of_the_page(tmp_path):
    svg = with_dark_colours(draw(tmp_path)[1].read_text())
    ET.fromstring(svg)
    assert f"stroke: var(--c5,{BLUE})" in svg
    assert f"--c5:{DARK_COLOURS[BLUE]};" in svg
    assert svg.count("prefers-color-scheme:dark") == 1


def test_rounded_outlines_keep_their_scale(tmp_path):
    svg = draw(tmp_path)[1].read_text()
    outlines = [node.get("d", "") for node in ET.fromstring(svg).iter()]
    numbers = [word for outline in outlines for word in outline.split() if "." in word]
    assert numbers
    assert all(len(number.partition(".")[2]) <= 2 for number in numbers)
    # Glyphs are drawn in 64ths of a point, so their scale must not be rounded.
    assert "scale(0.015625)" in svg
