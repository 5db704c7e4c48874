"""The report: one file, everything in it, nothing that gets out."""

import base64
import json
import re
from html.parser import HTMLParser

import pytest

from skystack.errors import InputError
from skystack.reporting.report import write_report


class Page(HTMLParser):
    """Tags, addresses and text of a page."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.addresses, self.attributes, self.text = [], [], [], ""
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [name for name, _ in attrs]
        self.addresses += [value for name, value in attrs if name in {"src", "href", "data"}]

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def html(reported):
    return (reported / "report.html").read_text()


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def test_every_row_and_the_bound_are_shown(page):
    for name in ("undamped", "damped", "damped and stacked", "do nothing", "fewest possible"):
        assert name in page.text
    assert "Online action-stacking" in page.text
    assert "a test machine" in page.text
    assert "skystack reproduce lateral --quick" in page.text
    assert "quick run" in page.text
    assert "7.2 ± 3.5" in page.text


def test_the_page_needs_nothing_else(html, page):
    assert "http" not in html
    assert "url(" not in html
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert page.addresses
    assert all(address.startswith("data:image/svg+xml;base64,") for address in page.addresses)


def test_pictures_are_drawings_with_words(html, page):
    drawings = re.findall(r'src="data:image/svg\+xml;base64,([^"]*)"', html)
    assert len(drawings) == page.tags.count("img") == 3 + 4 * 2 + 1 + 1 + 2
    for drawing in drawings:
        decoded = base64.b64decode(drawing)
        assert decoded.startswith(b"<?xml")
        assert b"prefers-color-scheme" in decoded
        assert b"<script" not in decoded
        assert b"<img" not in decoded
    assert page.attributes.count("alt") == len(drawings)


def test_a_callsign_cannot_become_markup(html, page, evil_callsign):
    assert evil_callsign not in html
    assert "&lt;img src=x onerror=alert(1)&gt;" in html
    assert "onerror" not in page.attributes
    assert f"{evil_callsign}, turn " in page.text


def test_nothing_of_this_machine_is_told(html, reported):
    assert str(reported) not in html
    assert str(reported.parent) not in html


def test_a_second_report_replaces_the_first(run):
    assert "fewest possible" in Page(write_report(run).read_text()).text
    files = {path.name for path in run.iterdir()}
    (run / "bound.json").unlink()
    path = run / "results.json"
    path.write_text(re.sub(r'"train": \[\{.*?\}\]', '"train": []', path.read_text()))
    text = Page(write_report(run).read_text()).text
    assert "fewest possible" not in text
    assert "Thin lines are single seeds" not in text
    assert {path.name for path in run.iterdir()} == files - {"bound.json"}


def test_a_missing_table_is_named_and_no_report_is_written(run):
    (run / "evaluation/lateral-s0-skystack-stacked/aircraft.parquet").unlink()
    with pytest.raises(InputError, match=r"aircraft\.parquet: missing"):
        write_report(run)
    assert not (run / "report.html").exists()
    assert not (run / "figures").exists()


def test_other_simulators_are_shown_where_they_were_flown_in(run, page):
    path = run / "results.json"
    results = json.loads(path.read_text())
    theirs = results["rows"][0] | {"platform": "bluebird", "same_clearances_rate": 0.97}
    path.write_text(json.dumps(results | {"platforms": [results["rows"][0], theirs]}))
    shown = Page(write_report(run).read_text())
    assert "Other simulators" in shown.text
    assert "97.0 %" in shown.text
    assert "Other simulators" not in page.text


def test_the_tables_are_there_as_markdown(reported):
    text = (reported / "results.md").read_text()
    assert "## Lateral navigation" in text
    assert "| damped and stacked " in text
    assert "| fewest possible " in text
    assert "| clearances, success | seed 0 | seed 1 |" in re.sub(" +", " ", text)
