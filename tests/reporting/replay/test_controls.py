"""The page's controls and layout in Chromium: lists, profile, measuring, filters, downloads."""

import csv
import io
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from skystack.reporting.replay.page import write_replay

from .browser import LAPTOP, PHONE, viewing
from .crowds import IN_LOSS, crowd, outcomes, write_page
from .made import ROWS
from .meeting import EVIL, FIRST_LOSS
from .test_separation import source

LANDSCAPE, TABLET = {"width": 844, "height": 390}, {"width": 768, "height": 1024}
SIZES = {"laptop": LAPTOP, "tablet": TABLET, "phone": PHONE, "landscape": LANDSCAPE}


@pytest.fixture(scope="module")
def pages(tmp_path_factory, evaluation, one_by_one, at_once, alone, climbing, far_north):
    folder = tmp_path_factory.mktemp("controls")

    def page(name, *runs):
        write_replay(runs, folder / f"{name}.html", scenarios=3)
        return folder / f"{name}.html"

    return {
        "evaluation": page("evaluation", evaluation),
        "meeting": page("meeting", one_by_one),
        "alone": page("alone", alone),
        "climbing": page("climbing", climbing),
        "far north": page("far north", far_north),
        "both": page("both", one_by_one, at_once),
        "crowd": write_page(folder / "crowd.html", crowd()),
        "outcomes": write_page(folder / "outcomes.html", outcomes()),
    }


@pytest.fixture
def open_page(browser, pages):
    return lambda name, link="", **context: viewing(browser, pages[name], link, **context)


def boxes(viewer, *selectors):
    """Left, top, right and bottom of elements, rounded to pixels."""
    found = []
    for selector in selectors:
        for each in viewer.page.locator(selector).all():
            box = each.bounding_box()
            found.append(
                [round(v) for v in (box["x"], box["y"])]
                + [round(box["x"] + box["width"]), round(box["y"] + box["height"])]
            )
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", ["meeting", "both"])
@pytest.mark.parametrize("size", ["phone", "landscape"])
def test_radar_is_visible_on_a_phone_either_way_up(open_page, name, size):
    viewport = SIZES[size]
    with open_page(name, viewport=viewport, has_touch=True) as viewer:
        for left, top, right, bottom in boxes(viewer, ".scope"):
            assert 0 <= left < right <= viewport["width"]
            assert 0 <= top < bottom <= viewport["height"]
            assert bottom - top > 0.23 * viewport["height"]
            if size == "landscape":
                assert bottom - top > 0.5 * viewport["height"]
                assert right - left > 0.45 * viewport["width"]
        assert viewer.pixels("conflict") > 50
        width = "document.documentElement.scrollWidth"
        assert viewer.page.evaluate(width) <= viewport["width"]
        (play,) = boxes(viewer, ".play")
        assert play[3] <= viewport["height"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["meeting", "both"])
@pytest.mark.parametrize("size", SIZES)
def test_nothing_moves_when_counts_and_alerts_change(open_page, name, size):
    fixed = (".scope", ".verdict", ".alerts-box", ".losses", ".timeline", ".play")
    with open_page(name, viewport=SIZES[size]) as viewer:
        before = boxes(viewer, *fixed)
        ends = [box[2] for box in boxes(viewer, ".count")]
        for row in (FIRST_LOSS, FIRST_LOSS + 1, 41, 46, 60):
            viewer.scrub_to(row)
            assert boxes(viewer, *fixed) == before
            assert [box[2] for box in boxes(viewer, ".count")] == ends


WORDS = """
() => {
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const broken = []; // of at most 12 letters: longer ones are no callsigns
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    if (node.parentElement.closest("script, style, template, .unseen, datalist, select")) continue;
    for (const { index, 0: word } of node.data.matchAll(/[^\\s\\u00a0/]+/g)) {
      if (word.length > 12) continue;
      const range = new Range();
      range.setStart(node, index);
      range.setEnd(node, index + word.length);
      const tops = [...range.getClientRects()].filter(({ width }) => width).map(({ top }) => top);
      if (Math.max(...tops) - Math.min(...tops) > 4) broken.push(word);
    }
  }
  return broken;
}
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["evaluation", "both", "outcomes", "climbing"])
@pytest.mark.parametrize("width", [390, 768, 844, 1024])
def test_no_word_is_broken(open_page, name, width):
    with open_page(name, viewport={"width": width, "height": 1024}) as viewer:
        viewer.keys("End")
        assert viewer.page.evaluate(WORDS) == []


SYMBOLS = """
() => {
  const masks = [undefined, "conflict", "loss"].map(kind => {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [40, 40];
    const pen = { g: canvas.getContext("2d"), colour: { radar: "#000000" } };
    pen.g.fillRect(0, 0, 40, 40);
    drawSymbol(pen, [20, 20], { kind, colour: "#ffffff", selected: false });
    const { data } = pen.g.getImageData(0, 0, 40, 40);
    return Array.from({ length: 1600 }, (_, at) => data[4 * at] > 128);
  });
  return [masks, RINGS];
}
"""


@pytest.mark.slow
def test_alerts_differ_in_shape_without_colour(browser):
    page = browser.new_page()
    masks, rings = page.evaluate(f"() => {{ {source('radar')} return ({SYMBOLS})(); }}")
    page.close()
    masks = np.array(masks)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert (masks[one] ^ masks[other]).sum() > 0.3 * (masks[one] | masks[other]).sum()
    assert rings["conflict"]["dash"]
    assert "dash" not in rings["loss"]
    assert rings["loss"]["width"] > 1.5 * rings["conflict"]["width"]


SHORTEN = """
([count, picturePx]) => {
  const lines = ["SKY100", "300", "466 H045"];
  const blocks = Array.from({ length: count }, (_, at) => ({ lines, least: at ? 1 : 4 }));
  const most = shorten(blocks, picturePx);
  return [most, blocks.map((each) => [each.lines.length, each.width * each.height])];
}
"""


@pytest.mark.parametrize(("count", "lines"), [(2, 3), (60, 3), (120, 2), (200, 1)])
def test_data_blocks_are_shortened_in_a_crowd(browser, count, lines):
    """They cover at most 30 % of a radar of 1000 by 640 pixels; the selected one stays complete."""
    page = browser.new_page()
    given = [count, 640_000]
    script = f"given => {{ {source('blocks')} return ({SHORTEN})(given); }}"
    _, blocks = page.evaluate(script, given)
    page.close()
    assert blocks[0][0] == 3
    assert {each for each, _ in blocks[1:]} == {lines}
    assert sum(area for _, area in blocks) <= 0.3 * 640_000


@pytest.mark.slow
def test_lists_and_timeline_have_the_symbols(open_page):
    with open_page("meeting") as viewer:

        def symbols(where):
            uses = viewer.page.locator(f"{where} use").all()
            return [each.get_attribute("href") for each in uses]

        assert symbols(".alerts") == ["#conflict"]
        viewer.scrub_to(FIRST_LOSS + 1)
        assert symbols(".alerts") == ["#loss"]
        assert symbols(".losses") == ["#loss"]
        assert viewer.page.locator("#marks .cross").count() == 2
        viewer.wait_until("document.querySelector('#marks .conflict')")
        span = viewer.page.locator("#marks .conflict")
        assert [span.get_attribute(name) for name in ("x1", "x2")] == ["0", str(FIRST_LOSS + 1)]


def test_verdict_states_losses_and_reasons(open_page):
    with open_page("outcomes") as viewer:
        verdict = viewer.page.locator(".verdict")
        options = viewer.page.locator("#scenario option").all_text_contents()
        failed = "failed: excursion (=1+1), too many clearances (=1+1, AC2); separation lost"
        expected = (failed, "success, but separation lost", "success")
        for number, text in enumerate(expected):
            viewer.page.locator("#scenario").select_option(str(number))
            assert verdict.inner_text() == text
            assert verdict.get_attribute("data-good") == str(text == "success").lower()
        assert options[0].endswith("failed: excursion, too many clearances")
        assert not any("failed" in option for option in options[1:])


@pytest.mark.slow
def test_list_has_all_alerts_and_leads_to_the_pairs(open_page):
    pairs = IN_LOSS * (IN_LOSS - 1) // 2
    with open_page("crowd", "scenario=4&cycle=5") as viewer:
        assert len(viewer.alerts) == pairs
        box = viewer.page.locator(".alerts-box")
        assert box.evaluate("e => e.scrollHeight > e.clientHeight")
        last = viewer.page.locator(".alerts button").last
        names = re.findall(r"SKY\d+", last.inner_text())
        last.click()
        assert viewer.selected == names
        assert viewer.link["aircraft"] == names
        losses = viewer.page.locator(".losses button")
        assert losses.count() == pairs
        losses.nth(pairs - 1).press("Enter")
        assert viewer.row == 3
        assert viewer.selected == ["SKY107", "SKY108"]


def test_focus_stays_on_an_alert_while_its_text_changes(open_page):
    with open_page("meeting") as viewer:
        viewer.page.locator(".alerts button").focus()
        viewer.keys("ArrowRight", "ArrowRight")
        assert viewer.row == 2
        assert viewer.page.evaluate("document.activeElement.closest('.alerts') !== null")


def test_link_restores_a_pair(open_page):
    with open_page("meeting", "scenario=0&cycle=0&aircraft=AC2&aircraft=nobody") as viewer:
        assert viewer.selected == ["AC2"]
        viewer.page.locator(".strip").first.click(modifiers=["Shift"])
        assert viewer.selected == [EVIL, "AC2"]
        assert viewer.link["aircraft"] == ["AC2", EVIL]
        viewer.page.locator(".strip").nth(1).press("Shift+Enter")
        assert viewer.selected == [EVIL]


def measured(viewer):
    viewer.settle()
    return viewer.page.locator(".measured").first.inner_text()


def test_measures_between_two_aircraft(open_page, far_north):
    """By the geodesic, they are 10 NM apart on a bearing of 090; without a pointer."""
    speed_kt = pq.read_table(far_north)["ground_speed_kt"][0].as_py()
    with open_page("far north") as viewer:
        viewer.page.locator(".strip").first.press("Enter")
        viewer.page.locator(".strip").nth(1).press("Shift+Enter")
        viewer.keys("m")
        seconds = round(10.0 / speed_kt * 3600.0)
        time = f"{seconds // 60}:{seconds % 60:02d} at {speed_kt:.0f} kt"
        assert measured(viewer) == f"AC1 to AC2: 10.0 NM, bearing 090\N{DEGREE SIGN}, {time}"
        pressed = viewer.page.locator("[data-key=m]").get_attribute("aria-pressed")
        assert pressed == "true"
        viewer.keys("Escape")
        assert measured(viewer) == ""
        assert viewer.selected == ["AC1", "AC2"]
        viewer.keys("Escape")
        assert viewer.selected == []


def test_measures_by_dragging_from_an_aircraft(open_page):
    """To the left edge of its ring of 5 NM, then to a point north of it."""
    with open_page("alone") as viewer:
        left, right, top, bottom = viewer.changed_by("r")
        box = viewer.page.locator(".scope canvas").bounding_box()
        x, y = box["x"] + (left + right) / 2, box["y"] + (top + bottom) / 2
        radius = (bottom - top) / 2
        viewer.page.locator("[data-key=m]").click()
        for right_nm, up_nm, nm, bearing in (
            (-20, 0, 20, 270),
            (0, 15, 15, 360),
            (15, 15, 21.2, 45),
        ):
            viewer.page.mouse.move(x, y)
            viewer.page.mouse.down()
            viewer.page.mouse.move(x + 10, y)
            viewer.page.mouse.move(x + right_nm / 5 * radius, y - up_nm / 5 * radius)
            viewer.page.mouse.up()
            words = re.fullmatch(
                r"AC1 to point: ([\d.]+) NM, bearing (\d{3})\S, (\d+):(\d\d) at 400 kt",
                measured(viewer),
            )
            found = [float(each) for each in words.groups()]
            assert found[0] == pytest.approx(nm, rel=0.04)
            assert found[1] == pytest.approx(bearing, abs=2)
            assert 60 * found[2] + found[3] == pytest.approx(found[0] / 400 * 3600, abs=1)
        # The line follows the aircraft, which flies 400 kt to the east, past the point.
        viewer.keys("End")
        words = re.match(r"AC1 to point: ([\d.]+) NM", measured(viewer))
        assert float(words[1]) == pytest.approx(np.hypot(15 - 400 / 60, 15), rel=0.05)
        assert viewer.selected == []


def test_long_measured_lines_have_their_true_length(browser):
    """North-south lines are geodesics, whose lengths pyproj gives."""
    from skystack.airspace.projection import SCALE_RANGE_NM

    from .conftest import WGS84
    from .test_separation import north

    plane = north().plane
    data = {"coefficients": plane.scale.coefficients, "range_nm": SCALE_RANGE_NM}
    start, end = (plane.to_plane(lat, 15.0).tolist() for lat in (60.0, 66.0))
    page = browser.new_page()
    body = f"{source('plane')} return new Plane(data).lengthNm(start, end);"
    found = page.evaluate(f"([data, start, end]) => {{ {body} }}", [data, start, end])
    page.close()
    expected = WGS84.inv(15.0, 60.0, 15.0, 66.0)[2] / 1852.0
    assert found == pytest.approx(expected, abs=0.05)


@pytest.mark.slow
def test_vertical_profile_of_the_selected_aircraft(open_page):
    with open_page("climbing") as viewer:
        caption = viewer.page.locator(".profile h3")
        canvas = viewer.page.locator(".profile canvas")
        assert caption.inner_text() == "Vertical profile: select an aircraft"
        viewer.keys("1", "ArrowRight")
        levels = "FL300, cleared FL300, in FL300, out FL300"
        assert caption.inner_text() == f"Vertical profile: {EVIL} {levels}"
        viewer.scrub_to(6)
        assert "FL300, cleared FL320" in caption.inner_text()
        assert canvas.get_attribute("aria-label") == caption.inner_text()
        viewer.keys("End")
        assert "FL320, cleared FL320" in caption.inner_text()
        # The plot begins 34 pixels from the left and ends 12 from the right.
        width = canvas.bounding_box()["width"]
        canvas.click(position={"x": 34 + (width - 46) * 20 / 60, "y": 40})
        assert viewer.row == 20
        viewer.keys("g")
        assert not canvas.is_visible()
    with open_page("meeting") as viewer:  # its only level clearance follows two turns
        assert viewer.page.locator(".profile").is_visible()
    with open_page("alone") as viewer:
        assert not viewer.page.locator(".profile").is_visible()
        viewer.keys("g")
        assert viewer.page.locator(".profile h3").inner_text().startswith("Vertical profile: AC1")


def test_finds_aircraft_by_callsign(open_page):
    with open_page("crowd") as viewer:
        viewer.keys("f")
        find = viewer.page.locator("#find")
        assert find.evaluate("e => e === document.activeElement")
        viewer.page.keyboard.type("sky104")
        assert viewer.selected == ["SKY104"]
        find.fill("106")
        viewer.keys("Enter")
        assert viewer.selected == ["SKY106"]
        viewer.keys("ArrowRight")  # the keys work again
        assert viewer.row == 1
        viewer.keys("/")
        find.fill("<b>nobody")
        viewer.keys("Enter")
        assert viewer.page.locator("#notice").inner_text() == "There is no aircraft <b>nobody."
        assert viewer.selected == ["SKY106"]


def drawn(viewer):
    """The number of pixels of aircraft that are neither selected nor in an alert."""
    return viewer.pixels("aircraft") + viewer.pixels("waiting")


def test_level_filter(open_page):
    """At FL300 and FL320, until the first is cleared to the second's level."""
    with open_page("climbing") as viewer:
        levels = viewer.page.locator(".levels-shown")
        full = drawn(viewer)
        viewer.keys("o")
        viewer.page.locator("#from-fl").fill("310")
        viewer.settle()
        assert levels.inner_text() == "FL310 to FL999 only: 1 of 2 aircraft"
        assert drawn(viewer) < 0.7 * full
        dimmed = viewer.page.locator(".hidden-level .callsign")
        assert dimmed.all_text_contents() == [EVIL]
        viewer.page.locator("#to-fl").fill("315")
        viewer.settle()
        assert levels.inner_text() == "FL310 to FL315 only: 0 of 2 aircraft"
        viewer.scrub_to(6)  # climbs through these levels, in conflict with the other
        viewer.settle()
        assert levels.inner_text() == "FL310 to FL315 only: 2 of 2 aircraft"
        viewer.scrub_to(0)
        viewer.page.locator("#all-levels").click()
        viewer.settle()
        assert levels.inner_text() == ""
        assert drawn(viewer) == full
        viewer.page.locator("#from-fl").press("Escape")
        assert not viewer.page.locator("#options").is_visible()
        assert viewer.page.evaluate("document.activeElement.dataset.key") == "o"


def test_vector_and_trail_lengths(open_page):
    """In two minutes at 400 kt to the east, the aircraft flies 13.3 NM."""
    with open_page("alone", "scenario=0&cycle=10") as viewer:
        left, right, top, bottom = viewer.changed_by("r")
        box = viewer.page.locator(".scope canvas").bounding_box()
        viewer.page.mouse.move(box["x"] + (left + right) / 2, box["y"] + (top + bottom) / 2)
        viewer.page.mouse.wheel(0, -500)
        left, right, _, _ = viewer.changed_by("r")
        x, nm = (left + right) / 2, (right - left) / 10.0
        vector = viewer.page.locator("#vector")
        assert vector.input_value() == "1"
        assert viewer.changed_by("v")[1] - x == pytest.approx(400 / 30 * nm, abs=0.3 * nm)
        assert vector.input_value() == "5"  # the key was pressed twice
        viewer.keys("v")
        assert vector.input_value() == "1"
        seen = drawn(viewer)
        viewer.keys("h")
        assert viewer.page.locator("#trail").input_value() == "20"
        viewer.keys("o")
        viewer.page.locator("#trail").select_option("0")
        viewer.keys("Escape")
        assert drawn(viewer) < seen


def test_downloads_the_picture(open_page):
    with open_page("both", "scenario=0&cycle=30") as viewer:
        viewer.settle()
        with viewer.page.expect_download() as waiting:
            viewer.keys("i")
        assert waiting.value.suggested_filename == "replay-scenario-0-3m00s.png"
        picture = Image.open(waiting.value.path())
        sizes = viewer.page.locator(".scope canvas").evaluate_all(
            "all => all.map(({width, height}) => [width, height])"
        )
        assert picture.size == (sum(w for w, _ in sizes), sizes[0][1] + 30)
        pixels = np.asarray(picture.convert("RGB")).astype(int)
        assert (np.abs(pixels - (255, 116, 104)).max(axis=2) < 12).sum() > 100  # a loss


def test_downloads_the_clearances(open_page, evaluation):
    issued = pq.read_table(evaluation / "clearances.parquet").to_pylist()
    with open_page("evaluation", "scenario=1&cycle=3") as viewer:
        with viewer.page.expect_download() as waiting:
            viewer.keys("o")
            viewer.page.locator("[data-key=c]").click()
        assert waiting.value.suggested_filename == "replay-scenario-1.csv"
        text = waiting.value.path().read_bytes().decode()
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    names = ("scenario", "cycle", "callsign", "kind", "value", "direction", "instructions", "text")
    expected = [
        {name: "" if row[name] is None else str(row[name]) for name in names}
        for row in issued
        if row["scenario"] == 1
    ]
    assert [{name: row[name] for name in names} for row in rows] == expected
    for row in rows:
        assert row["run"] == "avoidance, stacked"
        assert int(row["time_s"]) == 6 * int(row["cycle"])


def test_downloaded_texts_are_no_formulas(open_page):
    with open_page("outcomes", "scenario=1") as viewer:
        with viewer.page.expect_download() as waiting:
            viewer.keys("c")
        text = waiting.value.path().read_bytes().decode()
    assert text.count("\r\n") == 3
    first, _ = csv.DictReader(io.StringIO(text, newline=""))
    assert (first["callsign"], first["value"]) == ("'=1+1", "90")
    assert first["text"] == "'=1+1 turn right heading 090"


def test_strip_shows_the_exit_offset_after_the_exit(open_page, evaluation):
    with open_page("outcomes", "scenario=1") as viewer:
        exits = viewer.page.locator(".strip .exit")
        viewer.scrub_to(ROWS - 5)
        assert exits.all_text_contents() == ["", ""]
        before = boxes(viewer, ".strip")
        viewer.keys("ArrowRight")
        assert boxes(viewer, ".strip") == before
        assert exits.all_text_contents() == ["", "exit 0.4\u00a0NM from its exit fix"]
        viewer.keys("End")
        assert exits.nth(1).inner_text() == "exit 0.4\u00a0NM from its exit fix"
    rows = pq.read_table(evaluation / "aircraft.parquet").to_pylist()
    with open_page("evaluation", "scenario=0") as viewer:
        viewer.keys("End")
        for row in (row for row in rows if row["scenario"] == 0):
            strip = viewer.page.locator(".strip").filter(has_text=row["callsign"])
            text = strip.locator(".exit").inner_text()
            if row["exit_offset_nm"] is None:
                assert text == ""
            else:
                assert text.startswith(
                    f"exit {row['exit_offset_nm']:.1f}\u00a0NM from its exit fix"
                )


@pytest.mark.slow
def test_every_control_has_a_name_and_is_reached_by_tab(open_page):
    with open_page("both") as viewer:
        viewer.keys("o")
        nameless = """
        () => [...document.querySelectorAll("button, select, input, canvas")]
          .filter(e => !e.closest("dialog, template"))
          .filter(e => !e.labels?.length && !e.ariaLabel && !e.textContent.trim())
          .map(e => e.outerHTML)
        """
        assert viewer.page.evaluate(nameless) == []
        reached = set()
        for _ in range(90):
            viewer.keys("Tab")
            active = "document.activeElement.id || document.activeElement.dataset.key"
            outline = "getComputedStyle(document.activeElement).outlineStyle"
            name = viewer.page.evaluate(active)
            if name:
                assert viewer.page.evaluate(outline) == "solid"
                reached.add(name)
        ids = {"find", "vector", "trail", "from-fl", "to-fl", "all-levels", "scenario", "scrubber"}
        assert reached >= ids | {"m", "o", "?", "r", "g", "t", "i", "c", "l", "speed"}
