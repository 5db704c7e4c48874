"""The page in Chromium: playing, stepping, scrubbing, selecting, links, log and alerts."""

import math
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from pyproj import Geod

from skystack.reporting.replay.page import write_replay
from tests.docs.blocks import ROOT

from .browser import PHONE, viewing
from .meeting import AHEAD_NM, BESIDE_NM, CLOSING_NM, EVIL, FIRST_LOSS, LAST_LOSS, meeting


@pytest.fixture(scope="module")
def pages(
    tmp_path_factory, evaluation, one_by_one, at_once, alone, climbing, converging, far_north
):
    folder = tmp_path_factory.mktemp("pages")

    def page(name, *runs):
        write_replay(runs, folder / f"{name}.html", scenarios=3)
        return folder / f"{name}.html"

    return {
        "evaluation": page("evaluation", evaluation),
        "meeting": page("meeting", one_by_one),
        "alone": page("alone", alone),
        "climbing": page("climbing", climbing),
        "converging": page("converging", converging),
        "far north": page("far north", far_north),
        "both": page("both", one_by_one, at_once),
    }


@pytest.fixture
def open_page(browser, pages):
    return lambda name, link="", **context: viewing(browser, pages[name], link, **context)


def clearances_of(folder, scenario):
    rows = pq.read_table(folder / "clearances.parquet").to_pylist()
    return [row for row in rows if row["scenario"] == scenario]


@pytest.mark.slow
def test_plays_and_pauses(open_page):
    with open_page("meeting") as viewer:
        assert viewer.row == 0
        viewer.keys("]", "]", "Space")
        viewer.wait_until("scrubber.valueAsNumber > 3")
        viewer.keys("Space")
        stopped = viewer.row
        viewer.page.wait_for_timeout(300)
        assert viewer.row == stopped


@pytest.mark.slow
def test_stops_at_the_end_and_restarts(open_page):
    with open_page("meeting", "scenario=0&cycle=58") as viewer:
        viewer.keys("]", "]", "k")
        viewer.wait_until("!document.body.classList.contains('playing')")
        assert viewer.row == 60
        viewer.keys("k")
        viewer.wait_until("scrubber.valueAsNumber < 10")


@pytest.mark.slow
def test_plays_at_the_chosen_speed(open_page):
    """At 60 times real time a cycle of 6 s lasts a tenth of a second."""
    with open_page("meeting") as viewer:
        viewer.page.locator("#speed").select_option("60")
        rows = viewer.play(frames=225, frame_ms=10, expression="scrubber.valueAsNumber")
        for number, row in enumerate(rows, 1):
            assert abs(row - number / 10) <= 1.0
        assert rows[-1] == 22


def test_steps_through_the_rows(open_page):
    with open_page("meeting") as viewer:
        viewer.keys("ArrowRight", "ArrowRight", "ArrowRight", "ArrowLeft")
        assert viewer.row == 2
        assert viewer.page.locator("#clock").inner_text() == "0:12 cycle 2 of 60"
        viewer.keys("End", "ArrowRight")
        assert viewer.row == 60
        viewer.keys("Home", "ArrowLeft")
        assert viewer.row == 0


def test_clearance_appears_in_the_row_after_its_cycle(open_page):
    with open_page("meeting") as viewer:
        assert viewer.log == []
        for row, text in (
            (41, "AC2 turn right heading 280"),
            (42, "AC2 turn right heading 290"),
            (46, f"{EVIL} climb FL320"),
        ):
            viewer.keys(".")
            assert (viewer.row, viewer.log[-1]) == (row, text)
            viewer.keys("ArrowLeft")
            assert text not in viewer.log
            viewer.keys("ArrowRight")
        viewer.keys(".")
        assert viewer.row == 46
        viewer.keys(",", "Shift+ArrowLeft", ",")
        assert viewer.row == 41
        strip = viewer.page.locator(".strip").nth(1)
        assert "H270→280" in strip.inner_text()


def test_a_heading_and_a_level_at_once_are_one_clearance(browser, fly, tmp_path):
    combined = {"cycle": 40, "callsign": "AC2", "heading_deg": 280, "fl": 320}
    write_replay([fly("combined", meeting(combined))], tmp_path / "page.html")
    with viewing(browser, tmp_path / "page.html", "scenario=0&cycle=60") as viewer:
        assert viewer.log == ["AC2 turn right heading 280, climb FL320"]
        assert "1 of 1 clearance" in viewer.page.locator(".count").inner_text()
        assert viewer.page.locator("#scenario").inner_text().startswith("0: 1 clearance")
        assert "1: H280 FL320" in viewer.page.locator(".strip").nth(1).inner_text()


def test_log_entries_lead_to_their_clearances(open_page, evaluation):
    issued = clearances_of(evaluation, 1)
    with open_page("evaluation", "scenario=1") as viewer:
        entries = viewer.page.locator(".log button")
        assert entries.count() == len(issued)
        for number in (len(issued) - 1, 0):
            entries.nth(number).click()
            assert viewer.row == issued[number]["cycle"] + 1
            current = viewer.page.locator(".log [aria-current] .text").inner_text()
            in_row = [row["text"] for row in issued if row["cycle"] == issued[number]["cycle"]]
            assert current in in_row
        for number, row in enumerate(issued):
            minutes, seconds = divmod(6 * row["cycle"], 60)
            assert entries.nth(number).locator("time").inner_text() == f"{minutes}:{seconds:02}"
            stacked = f"{row['instructions']} instructions" if row["instructions"] > 1 else ""
            assert entries.nth(number).locator(".stacked").inner_text() == stacked
    assert any(row["instructions"] > 1 for row in issued)


def test_timeline_marks_clearances_and_losses(open_page):
    with open_page("meeting") as viewer:
        marks = viewer.page.locator("#marks .clearance")
        at = [int(marks.nth(index).get_attribute("x1")) for index in range(marks.count())]
        assert at == [41, 42, 46]
        loss = viewer.page.locator("#marks .loss")
        begins, width = (int(loss.get_attribute(name)) for name in ("x", "width"))
        assert (begins, begins + width) == (FIRST_LOSS, LAST_LOSS)
        # The marks span the travel of the scrubber's thumb, so each is above the thumb at its row.
        box = viewer.page.locator("#marks").bounding_box()
        viewer.page.mouse.click(box["x"] + box["width"] * 41 / 60, box["y"] + box["height"] / 2)
        assert viewer.row == 41


@pytest.mark.slow
def test_alerts_of_predicted_and_actual_losses(open_page):
    """On straight tracks, the formula gives the loss from the first row on."""
    with open_page("meeting") as viewer:
        for row in (0, 10, FIRST_LOSS):
            viewer.scrub_to(row)
            to_go_nm = AHEAD_NM - CLOSING_NM * row - math.sqrt(4.9995**2 - BESIDE_NM**2)
            seconds = round(to_go_nm / CLOSING_NM * 6)
            left = f"{seconds // 60}:{seconds % 60:02d}"
            assert viewer.alerts == [f"{EVIL} and AC2: conflict in {left}, min 3.0 NM"]
        assert viewer.pixels("conflict") > 50
        assert viewer.pixels("loss") == 0
        for row in range(FIRST_LOSS + 1, LAST_LOSS):
            viewer.scrub_to(row)
            apart = math.hypot(AHEAD_NM - CLOSING_NM * row, BESIDE_NM)
            shown = f"{math.floor(apart * 10) / 10:.1f} NM"
            assert viewer.alerts == [f"{EVIL} and AC2: loss of separation, {shown}"]
        assert viewer.pixels("loss") > 50
        viewer.scrub_to(LAST_LOSS + 1)
        assert viewer.alerts == []
        assert viewer.pixels("conflict") == viewer.pixels("loss") == 0


def test_predicts_a_conflict_from_ten_minutes_before_the_loss(open_page, converging):
    """The time of the loss is computed from the recorded positions with geodesics."""
    table = pq.read_table(converging)
    lat, lon = (table[name].to_numpy().reshape(-1, 2).T for name in ("lat", "lon"))
    apart_nm = np.array(Geod(ellps="WGS84").inv(lon[0], lat[0], lon[1], lat[1])[2]) / 1852.0
    lost_s = 6.0 * np.interp(-4.9995, -apart_nm, np.arange(len(apart_nm)))
    first, part = divmod(lost_s - 600.0, 6.0)
    assert first > 100
    assert 0.1 < part / 6.0 < 0.9
    with open_page("converging") as viewer:
        viewer.scrub_to(int(first))
        assert viewer.alerts == []
        viewer.keys("ArrowRight")
        (alert,) = viewer.alerts
        assert alert.startswith("AC1 and AC2: conflict in 9:5")


def test_rings_have_their_true_size_far_north(open_page):
    """5 NM rings around two aircraft 10 NM apart touch: together they are twice as wide as high.
    With lengths of the plane, which are 9 % longer there, they would be 2.09 times as wide."""
    with open_page("far north") as viewer:
        left, right, top, bottom = viewer.changed_by("r")
        viewer.page.mouse.move(*_moved(viewer, (left + right) / 2, (top + bottom) / 2))
        viewer.page.mouse.wheel(0, -1000)
        left, right, top, bottom = viewer.changed_by("r")
        assert bottom - top > 80
        assert (right - left) / (bottom - top) == pytest.approx(2.0, abs=0.03)


def test_conflict_depends_on_cleared_levels(open_page):
    """There is none at 2,000 ft apart. The row that shows the cleared climb shows the conflict."""
    with open_page("climbing", "scenario=0&cycle=5") as viewer:
        levels = viewer.page.locator(".strip .now").first
        assert viewer.alerts == []
        assert levels.inner_text().startswith("FL300 ")
        viewer.keys("ArrowRight")
        assert len(viewer.alerts) == 1
        assert levels.inner_text().startswith("FL300\N{UPWARDS ARROW}320 ")
        assert viewer.page.locator(".verdict").inner_text() == "separation lost"


def test_keeps_the_selection_while_scrubbing(open_page):
    with open_page("meeting") as viewer:
        before = viewer.pixels("selected")
        viewer.keys("2")
        assert viewer.selected == ["AC2"]
        viewer.scrub_to(50)
        assert viewer.selected == ["AC2"]
        assert viewer.pixels("selected") > before + 50
        viewer.keys("Escape")
        assert viewer.selected == []


def test_click_selects_the_aircraft_drawn_there(open_page):
    """The aircraft is at the centre of its ring, which a key hides."""
    with open_page("alone") as viewer:
        left, right, top, bottom = viewer.changed_by("r")
        assert right - left == pytest.approx(bottom - top, abs=3)
        canvas = viewer.page.locator(".scope canvas")
        canvas.click(position={"x": (left + right) / 2, "y": (top + bottom) / 2})
        assert viewer.selected == ["AC1"]
        canvas.click(position={"x": 5, "y": 300})
        assert viewer.selected == []


def test_zoom_and_pan_move_the_picture(open_page):
    with open_page("alone") as viewer:

        def ring():
            left, right, top, bottom = viewer.changed_by("r")
            return (left + right) / 2, (top + bottom) / 2, right - left

        x, y, width = ring()
        viewer.keys("+")
        assert ring()[2] == pytest.approx(1.3 * width, abs=4)
        viewer.keys("-", "w", "a")
        assert ring() == pytest.approx((x + 60, y + 60, width), abs=3)
        viewer.keys("0")
        viewer.page.locator(".scope canvas").hover(position={"x": 300, "y": 300})
        viewer.page.mouse.down()
        viewer.page.mouse.move(*_moved(viewer, 350, 280))
        viewer.page.mouse.up()
        assert ring() == pytest.approx((x + 50, y - 20, width), abs=3)
        assert viewer.selected == []
        viewer.keys("0")
        assert ring() == pytest.approx((x, y, width), abs=1)
        viewer.page.mouse.wheel(0, -500)
        assert ring()[2] == pytest.approx(math.e * width, abs=6)


def test_zooms_with_two_fingers(open_page):
    """Fingers that move 1.5 times as far apart zoom by 1.5 about the point between them."""
    with open_page("alone", viewport=PHONE, has_touch=True) as viewer:
        before = viewer.changed_by("r")
        touch = viewer.page.context.new_cdp_session(viewer.page)
        x, y = _moved(viewer, (before[0] + before[1]) / 2, (before[2] + before[3]) / 2)
        for kind, apart in (("touchStart", 40), ("touchMove", 50), ("touchMove", 60)):
            fingers = [{"x": x - apart, "y": y, "id": 0}, {"x": x + apart, "y": y, "id": 1}]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        after = viewer.changed_by("r")
        assert after[1] - after[0] == pytest.approx(1.5 * (before[1] - before[0]), abs=4)
        assert after[0] + after[1] == pytest.approx(before[0] + before[1], abs=6)
        assert viewer.selected == []


def _moved(viewer, x, y):
    box = viewer.page.locator(".scope canvas").bounding_box()
    return box["x"] + x, box["y"] + y


@pytest.mark.slow
def test_link_restores_scenario_cycle_and_selection(open_page):
    with open_page("evaluation", "scenario=2&cycle=17&aircraft=AC2") as viewer:
        assert (viewer.row, viewer.selected) == (17, ["AC2"])
        assert viewer.page.locator("#scenario").input_value() == "2"
        viewer.keys("p", "ArrowRight")
        assert viewer.link == {"scenario": ["1"], "cycle": ["1"], "aircraft": ["AC2"]}
        # The page may update its address before it is told of a new one.
        update = "history.replaceState(null, '', '#scenario=1&cycle=1')"
        viewer.page.evaluate(f"location.hash = 'scenario=0&cycle=9'; {update}")
        viewer.wait_until("scrubber.valueAsNumber === 9")
        assert viewer.selected == []
    with open_page("meeting", "scenario=0&cycle=3") as viewer:
        viewer.keys("1")
        assert viewer.link["aircraft"] == [EVIL]


@pytest.mark.parametrize(
    ("link", "row"),
    [("scenario=99&cycle=5", 0), ("cycle=5", 0), ("scenario=0&cycle=1e9", 60), ("%%%&=", 0)],
)
def test_invalid_links_open_at_the_first_or_last_row(open_page, link, row):
    with open_page("meeting", link) as viewer:
        assert viewer.row == row
        assert ("no scenario 99" in viewer.page.locator("#notice").inner_text()) == ("99" in link)


def test_selects_scenarios(open_page, evaluation):
    episodes = pq.read_table(evaluation / "episodes.parquet").to_pylist()[:3]
    with open_page("evaluation") as viewer:
        options = viewer.page.locator("#scenario option").all_text_contents()
        for option, episode in zip(options, episodes, strict=True):
            assert option.startswith(f"{episode['scenario']}: {episode['clearances']} clearances")
            assert ("loss of separation" in option) == episode["loss_of_separation"]
            assert ("failed" in option) == (not episode["success"])
        log = viewer.page.locator(".log button")
        viewer.page.locator("#scenario").select_option("1")
        assert log.count() == episodes[1]["clearances"]
        viewer.page.locator("#scenario").blur()
        viewer.keys("n")
        assert log.count() == episodes[2]["clearances"]
        viewer.keys("ArrowUp", "ArrowUp")
        assert log.count() == episodes[0]["clearances"]


def test_texts_from_files_are_not_interpreted_as_html(open_page):
    with open_page("meeting") as viewer:
        assert viewer.page.locator(".strip .callsign").first.inner_text() == EVIL
        assert viewer.page.locator("h2").first.inner_text() == "one &amp; <b>one"
        assert viewer.page.title() == "one &amp; <b>one: radar replay"
        assert viewer.page.locator("img, main b").count() == 0


@pytest.mark.slow
def test_runs_side_by_side_stay_in_step(open_page):
    """In every row the counts match the clearances issued so far, also during playback."""
    with open_page("both") as viewer:
        for row in range(38, 48):
            viewer.scrub_to(row)
            assert viewer.counts == [(row >= 41) + (row >= 42) + (row >= 46), int(row >= 41)]
        viewer.scrub_to(38)
        viewer.page.locator("#speed").select_option("10")
        counts = "[...document.querySelectorAll('.count strong')].map(c => Number(c.textContent))"
        expression = f"[scrubber.valueAsNumber, ...{counts}]"
        seen = viewer.play(frames=65, frame_ms=50, expression=expression)
        assert {row for row, _, _ in seen} == {38, 39, 40, 41, 42, 43}
        for row, first, other in seen:
            assert (first, other) == ((row >= 41) + (row >= 42), int(row >= 41))
        assert viewer.page.locator("#marks .clearance").count() == 4
        viewer.keys("2")
        assert viewer.selected == ["AC2", "AC2"]


def test_works_without_a_mouse(open_page):
    with open_page("both") as viewer:
        names = viewer.page.locator("button[data-key]").evaluate_all(
            "all => all.map(each => each.getAttribute('aria-label'))"
        )
        assert all(names)
        for _ in range(60):
            viewer.keys("Tab")
            if viewer.page.evaluate("document.activeElement.classList.contains('strip')"):
                break
        outline = "getComputedStyle(document.activeElement).outlineStyle"
        assert viewer.page.evaluate(outline) == "solid"
        viewer.keys("Enter")
        assert viewer.selected == [EVIL, EVIL]


def test_help_and_documentation_list_the_same_keys(open_page):
    with open_page("alone") as viewer:
        viewer.keys("?")
        help_ = viewer.page.locator("#help")
        assert help_.is_visible()
        terms = help_.locator("dt").all_text_contents()
        keys = dict(zip(terms, help_.locator("dd").all_text_contents(), strict=True))
        viewer.keys("ArrowRight", "Escape")
        assert (viewer.row, help_.is_visible()) == (0, False)
    text = (ROOT / "docs" / "replay.md").read_text()
    table = re.findall(r"^\| (\S.*?) \| (.*?) \|$", text.split("## Keys")[1], re.MULTILINE)
    assert dict(table[1:]) == keys


@pytest.mark.slow
def test_light_and_dark_themes(open_page):
    for scheme, light in (("dark", False), ("light", True)):
        with open_page("alone", color_scheme=scheme) as viewer:

            def is_light():
                viewer.settle()
                return viewer.page.locator(".scope canvas").evaluate(
                    "c => c.getContext('2d').getImageData(2, 2, 1, 1).data[0] > 128"
                )

            assert is_light() == light
            viewer.keys("t")
            assert is_light() != light


@pytest.mark.slow
@pytest.mark.parametrize("name", ["meeting", "both"])
def test_fits_a_phone(open_page, name):
    with open_page(name, viewport=PHONE, has_touch=True, device_scale_factor=2) as viewer:
        width = "document.documentElement.scrollWidth"
        assert viewer.page.evaluate(width) <= PHONE["width"]
        radar, log = (viewer.page.locator(part).last.bounding_box() for part in (".scope", ".log"))
        assert radar["y"] + radar["height"] <= log["y"]
        play = viewer.page.locator(".play").bounding_box()
        assert play["y"] + play["height"] <= PHONE["height"]
        assert min(play["width"], play["height"]) >= 40
