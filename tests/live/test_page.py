"""A whole session in a real browser: conflicts, advice, clearances, going back, and the replay."""

import pytest

from skystack.errors import InputError
from skystack.live.recorded import LiveSession
from skystack.reporting.replay.page import write_replay

from ..reporting.replay.browser import LAPTOP, TIMEOUT_MS, Viewer, viewing
from .made import ADVISER, on_frequency
from .serving import served

TABLET = {"width": 820, "height": 1180}


@pytest.fixture
def session():
    with served(steps=60) as found:
        yield found


class Page(Viewer):
    """What a controller sees and does."""

    def __init__(self, browser, link, viewport=LAPTOP) -> None:
        self.context = browser.new_context(viewport=viewport, color_scheme="dark")
        super().__init__(self.context.new_page())
        self.page.set_default_timeout(TIMEOUT_MS)
        self.problems: list[str] = []
        self.page.on("pageerror", lambda error: self.problems.append(str(error)))
        self.page.on(
            "console",
            lambda message: message.type == "error" and self.problems.append(message.text),
        )
        self.page.goto(link)
        self.wait_until("document.querySelector('#scrubber').value !== '0'")

    def text(self, selector: str) -> str:
        return self.page.locator(selector).first.inner_text()

    def wait_for(self, selector: str, part: str) -> None:
        """Wait until an element contains a text."""
        self.page.locator(selector).filter(has_text=part).first.wait_for()


@pytest.fixture
def page(browser, session):
    found = Page(browser, session.link)
    yield found
    assert found.problems == []
    found.context.close()


def clearances(session):
    return [
        each["clearances"][0]["text"]
        for each in session.control.history.updates
        if "clearances" in each
    ]


@pytest.mark.slow
def test_a_whole_session(session, page, tmp_path, browser):
    control = session.control
    assert page.row == 60
    assert page.text("#who").startswith("You control all flights. ")
    assert page.text("#who").endswith(" waiting to enter. Paused.")
    assert len(page.page.locator(".strip:visible").all()) >= len(control.hour.slots)
    # A conflict is predicted, and shown as the session predicts it.
    predicted = [each for each in control.views.monitor()["pairs"] if each["lost_in_s"] is not None]
    assert predicted
    page.wait_for(".alerts", "conflict in")
    # A clearance is typed, tried, issued and read back.
    name = on_frequency(control.hour)[0]
    page.keys("Enter")
    page.page.keyboard.type(f"{name} left 30 degrees")
    page.wait_for("#trial", f"{name} turn left heading")
    assert clearances(session) == []
    page.keys("Enter")
    page.wait_for("#answer", f", {name}”")
    (issued,) = clearances(session)
    page.wait_for(".log", issued)
    page.wait_for(".pending .callsign", name)  # not flown yet
    # Advice is shown, modified and accepted.
    page.keys("Escape", "q")
    page.wait_for("#alternatives", "Accept")
    assert page.text("#situation")
    page.page.locator("#alternatives button", has_text="Modify").first.click()
    words = page.page.locator("#clearance").input_value()
    page.wait_for("#trial", words.split()[0])
    page.page.locator("#clearance").fill(f"{words.split()[0]} fly heading 360")
    page.keys("Enter")
    page.wait_for("#answer", f", {words.split()[0]}”")
    page.keys("Escape", "q")
    page.wait_for("#alternatives", "Accept")
    wanted = page.text("#alternatives .words")
    page.keys("Alt+1")
    page.wait_for(".log", wanted)
    assert clearances(session)[-1] == wanted
    assert control.log.chosen()
    # It is flown, at the chosen speed, then paused.
    page.page.locator("#speed").select_option("60")
    page.keys("Escape", "k")
    page.wait_until("Number(document.querySelector('#scrubber').value) >= 70")
    page.keys("k")
    page.wait_for("#who", "Paused")
    assert "pending" not in (page.page.locator(".strips li").first.get_attribute("class") or "")
    # The recording is replayed.
    recorded: LiveSession = control.opened
    folder, _ = recorded.write(tmp_path)
    replay = tmp_path / "replay.html"
    write_replay([folder], replay)
    with viewing(browser, replay) as viewer:
        viewer.keys("End")
        assert issued in viewer.log
        assert wanted in viewer.log


@pytest.mark.slow
def test_a_heading_is_dragged_and_a_level_is_picked(session, page):
    name = on_frequency(session.control.hour)[0]
    page.page.locator(".strip", has_text=name).first.click()
    page.keys("Enter")  # the strip that was clicked does not keep the focus
    assert page.page.evaluate("document.activeElement.id") == "clearance"
    page.keys("Escape")
    page.wait_for("#ladder", "300")
    assert page.page.locator("#ladder .exit").count() == 1
    assert page.page.locator("#ladder [aria-current]").count() == 1
    page.page.locator("#ladder button", has_text="400").click()
    assert "FL400" in page.page.locator("#clearance").input_value()
    page.page.locator(".turns button", has_text="right 30").click()
    text = page.page.locator("#clearance").input_value()
    assert "turn right heading" in text
    assert "FL400" in text
    page.page.locator("#fixes button").last.click()
    text = page.page.locator("#clearance").input_value()
    assert "direct" in text
    assert "heading" not in text
    page.page.locator("#issue button").click()
    page.wait_for("#answer", f", {name}”")
    assert clearances(session)[-1].startswith(f"{name} resume own navigation direct")


@pytest.mark.slow
def test_advice_is_offered_and_stays_valid_for_some_cycles(session, page):
    page.page.locator("#offer").check()
    page.wait_for("#alternatives", "Accept")
    assert "separation is lost" in page.text("#situation")
    for cycle in (61, 62):
        page.keys("ArrowRight")
        page.wait_until(f"Number(document.querySelector('#scrubber').value) === {cycle}")
    wanted = page.text("#alternatives .words")
    page.keys("Alt+1")
    page.wait_for(".log", wanted)
    assert clearances(session) == [wanted]


@pytest.mark.slow
def test_flights_are_handed_over_and_taken_back(session, page):
    page.keys("x")
    page.wait_for("#who", f"{ADVISER} controls all flights")
    page.keys("ArrowRight")
    page.wait_until("Number(document.querySelector('#scrubber').value) === 61")
    assert clearances(session)
    page.wait_for(".log", clearances(session)[0])
    page.keys("x")
    page.wait_for("#who", "You control all flights")


def test_looking_back_changes_nothing_until_the_session_continues_there(session, page):
    page.keys("x", "ArrowRight")
    page.wait_until("Number(document.querySelector('#scrubber').value) === 61")
    page.scrub_to(40)
    assert page.row == 40
    assert session.control.cycle == 61
    page.page.locator("[data-do=rewind]").click()
    page.wait_until("document.querySelector('[data-do=rewind]').hidden")
    assert session.control.cycle == 40
    assert clearances(session) == []
    page.wait_until("document.querySelectorAll('.log .text').length === 0")


def test_the_past_stays_on_screen_if_going_back_is_refused(session, page, monkeypatch):
    def refuse(cycle):
        raise InputError("the disk is full")

    monkeypatch.setattr(session.control, "rewind", refuse)
    page.scrub_to(40)
    page.page.locator("[data-do=rewind]").click()
    page.wait_for("body", "the disk is full")
    assert page.row == 40
    assert page.page.locator("[data-do=rewind]").is_visible()
    page.keys("End", "ArrowRight")  # the session goes on
    page.wait_until("Number(document.querySelector('#scrubber').value) === 61")


@pytest.mark.slow
def test_a_page_that_is_opened_again_finds_the_session_as_it_was(session, page, browser):
    name = on_frequency(session.control.hour)[0]
    session.control.clear(f"{name} left 20 degrees")
    strips = page.page.locator(".strip .callsign").all_text_contents()
    page.page.reload()
    page.wait_until("document.querySelector('#scrubber').value === '60'")
    assert page.page.locator(".strip .callsign").all_text_contents() == strips
    page.wait_for(".log", clearances(session)[0])
    assert page.page.url.startswith(session.link.split("?")[0])
    assert "token" not in page.page.url
    other = Page(browser, session.link, TABLET)  # a second browser watches the same session
    other.wait_for(".log", clearances(session)[0])
    assert other.page.locator("#clearance").is_visible()
    page.keys("ArrowRight")
    other.wait_until("document.querySelector('#scrubber').value === '61'")
    assert other.problems == []
    other.context.close()


def test_a_changed_address_and_keys_of_replays_leave_the_session_alone(session, page):
    strips = page.page.locator(".strip .callsign").all_text_contents()
    page.keys("n", "p", "ArrowDown", "ArrowUp")
    page.page.evaluate("location.hash = 'scenario=0&cycle=30'")
    page.wait_until("document.querySelector('#scrubber').value === '30'")
    page.keys("End")
    assert page.row == 60
    assert page.page.locator(".strip .callsign").all_text_contents() == strips
    page.keys("?")
    assert "next scenario" not in page.text("#keys")
    assert "hand the selected flight over" in page.text("#keys")
    assert "return to the present" in page.text("#keys")
    assert "in the past, one cycle forward" in page.text("#keys")
