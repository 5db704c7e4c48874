"""The report: complete, self-contained and safe."""

import base64
import json
import re
from html.parser import HTMLParser

import pytest

from skystack.errors import InputError
from skystack.evaluation.statistics import MEASURES
from skystack.reporting import report
from skystack.reporting.report import write_report
from tests.reporting.conftest import add_copy, change_row, write_run

pytestmark = pytest.mark.usefixtures("blank_pictures")


class Page(HTMLParser):
    """The tags, addresses, links, ids, attributes and text of a page."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.addresses, self.attributes, self.text = [], [], [], ""
        self.links, self.ids = [], []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [name for name, _ in attrs]
        self.addresses += [value for name, value in attrs if name in {"src", "href", "data"}]
        self.links += [value for name, value in attrs if name == "href"]
        self.ids += [value for name, value in attrs if name == "id"]

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def html(reported):
    return (reported / "report.html").read_text()


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


@pytest.mark.slow
def test_report_shows_every_row_and_the_bound(page):
    for name in ("undamped", "damped", "damped and stacked", "do nothing", "fewest possible"):
        assert name in page.text
    assert "Online action-stacking" in page.text
    assert "a test machine" in page.text
    assert "skystack reproduce lateral --quick" in page.text
    assert "quick run" in page.text
    assert "7.2 ± 3.5" in page.text


@pytest.mark.slow
def test_report_is_self_contained(html, page):
    assert "http" not in html
    assert "url(" not in html
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    embedded = [address for address in page.addresses if address not in page.links]
    assert embedded
    assert all(address.startswith("data:image/svg+xml;base64,") for address in embedded)


def test_links_lead_to_sections_and_to_files_of_the_run(page, reported):
    """Each section has an identifier of its own."""
    assert len(set(page.ids)) == len(page.ids)
    sections = {link[1:] for link in page.links if link.startswith("#")}
    assert sections == {"task", "lateral", "run"} == set(page.ids)
    files = {link for link in page.links if not link.startswith("#")}
    assert files == {"results.md", "results.json", "replay-lateral.html"}
    assert all((reported / name).is_file() for name in files)


def test_headline_states_what_stacking_achieved(page, reported):
    rows = json.loads((reported / "results.json").read_text())["rows"]
    found = {(row["experiment"], row["stacking"]): row for row in rows}
    plain, stacked = found["lateral", False], found["lateral", True]
    assert plain["clearances_mean"] > stacked["clearances_mean"]
    assert (
        "Lateral navigation with the paper's settings, trained briefly: stacking reduces the "
        "clearances per scenario from "
        f"{plain['clearances_mean']:.1f} to {stacked['clearances_mean']:.1f}, "
        f"at {100.0 * stacked['success_rate']:.1f} % success."
    ) in page.text


def tiles_of(html):
    """The texts of each tile."""
    tiles = re.search(r'<ul class="tiles">(.*?)</ul>', html, re.DOTALL)
    found = re.findall(r"<li>(.*?)</li>", tiles[1], re.DOTALL) if tiles else []
    return [tuple(re.findall(r">([^<]+)<", tile)) for tile in found]


@pytest.mark.slow
def test_tiles_show_clearances_and_success_of_trained_policies(run):
    """Not of doing nothing, of shipped policies, or of rows of less importance."""
    for name in ("lateral-large", "lateral-best", "lateral-shipped", "do-nothing-lateral"):
        add_copy(run, name)
    measured = {"clearances_mean": 7.24, "success_rate": 0.985}
    change_row(run, "lateral", **measured)
    change_row(run, "lateral-best", clearances_mean=2.0, success_rate=0.5)
    change_row(run, "do-nothing-lateral", success_rate=0.2)
    bound = ("Fewest possible, lateral", "1.6", "10-degree turns")
    assert tiles_of(write_report(run).read_text()) == [
        ("Damped and stacked", "7.2", "98.5 % success, paper 7.2"),
        ("Ours, stacked", "2.0", "50.0 % success, paper 7.2"),
        bound,
    ]
    change_row(run, "lateral-best", paper=None)
    change_row(run, "lateral", success_rate=0.49)
    html = write_report(run).read_text()
    assert tiles_of(html) == [("Ours, stacked", "2.0", "50.0 % success"), bound]
    sentence = "2.0 clearances per scenario, at 50.0 % success (fewest possible: 1.6)."
    assert f"Lateral navigation with our own settings, trained briefly, stacked: {sentence}" in html


def test_untrained_policies_are_named_but_not_shown(run):
    change_row(run, "lateral", success_rate=0.29)
    (run / "bound.json").unlink()
    html = write_report(run).read_text()
    page = Page(html)
    assert tiles_of(html) == []
    assert "stacking reduces" not in page.text
    assert "One scenario, flown by every policy" not in page.text
    assert page.text.count("not trained") == 2 + 1  # two tables and the note on them
    assert "less than 30 points above that of doing nothing" in page.text
    assert "not trained" in (run / "results.md").read_text()
    assert not any("replay" in link for link in page.links)
    assert not list(run.glob("replay-*"))


@pytest.mark.slow
def test_rows_of_the_overview_are_unfolded(run):
    """And all rows of other families, which have no overview."""
    add_copy(run, "lateral-large")
    add_copy(run, "mine", task="holding")
    html = write_report(run).read_text()
    found = re.findall(r'<details class="fold row"( open)?>\s*<summary>([^:]+): \d', html)
    assert found == [
        (" open", "Damped and stacked"),
        ("", "37 actions, stacked"),
        (" open", "Mine, stacked"),
    ]
    assert {"#lateral", "#holding", "replay-lateral.html", "replay-holding.html"} <= set(
        Page(html).links
    )


@pytest.fixture
def replays(monkeypatch):
    """The replays that are written: evaluation folders, file name and scenario."""
    written = []

    def write(folders, path, only):
        written.append(([folder.name for folder in folders], path.name, only))

    monkeypatch.setattr(report, "write_replay", write)
    return written


@pytest.mark.slow
def test_replays_the_last_policy_without_and_with_stacking(tmp_path, replays):
    """In the scenario that is drawn. Shipped policies and doing nothing are not replayed."""
    rows = [("lateral", False), ("lateral", True), ("do-nothing-lateral", False)]
    run = write_run(tmp_path / "run", rows=rows, seeds=(3, 0), scenarios=3)
    add_copy(run, "lateral-shipped")
    path = run / "results.json"
    text = Page(write_report(run).read_text()).text
    ((folders, name, number),) = replays
    assert folders == ["lateral-s0-skystack-plain", "lateral-s0-skystack-stacked"]
    assert name == "replay-lateral.html"
    assert f"Scenario {number} of the evaluation" in text
    add_copy(run, "lateral-best")
    write_report(run)
    assert replays[-1][0] == ["lateral-best-s0-skystack-stacked"]
    change_row(run, "lateral-best", success_rate=0.0)
    change_row(run, "lateral", False, success_rate=0.0)
    write_report(run)
    assert replays[-1][0] == ["lateral-s0-skystack-stacked"]
    stored = json.loads(path.read_text())
    plain = [row for row in stored["rows"] if not row["stacking"]]
    path.write_text(json.dumps(stored | {"rows": plain}))
    count = len(replays)
    assert not any("replay" in link for link in Page(write_report(run).read_text()).links)
    assert len(replays) == count


def test_replay_contains_only_the_scenario_that_is_drawn(reported, page):
    """Flown without and with stacking. Both the contents and the scenario link to it."""
    replay = (reported / "replay-lateral.html").read_text()
    assert "<img src=x onerror" not in replay
    (recorded,) = re.findall(r'<script id="recorded"[^>]*>(.*?)</script>', replay, re.DOTALL)
    numbers = [
        [each["number"] for each in one["scenarios"]] for one in json.loads(recorded)["runs"]
    ]
    (number,) = re.findall(r"Scenario (\d+) of the evaluation", page.text)
    assert numbers == [[int(number)]] * 2
    assert page.links.count("replay-lateral.html") == 2


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [(0,), (0, 1)])
def test_results_by_seed_are_shown_only_with_several_seeds(tmp_path, seeds):
    run = write_run(tmp_path / "run", rows=[("lateral", True)], seeds=seeds, scenarios=1)
    change_row(run, "lateral", statistics=statistics_of(0.9))
    text = Page(write_report(run).read_text()).text
    assert ("Results by seed" in text) == (len(seeds) > 1)
    assert ("interquartile means over seeds" in text) == (len(seeds) > 1)
    assert ("success, interquartile" in text) == (len(seeds) > 1)
    assert "Uncertainty" in text


def statistics_of(value):
    """The same value for each measure, with intervals without width."""
    return {name: {"mean": [value] * 3, "iqm": [value] * 3} for name in MEASURES}


@pytest.mark.slow
def test_contents_lead_to_the_claims_if_there_are_any(run):
    assert "#lateral-claims" not in Page(write_report(run).read_text()).links
    change_row(run, "lateral", statistics=statistics_of(0.9), clearances_mean=7.0)
    page = Page(write_report(run).read_text())
    assert "#lateral-claims" in page.links
    assert "lateral-claims" in page.ids
    assert "clearances per scenario, damped and stacked" in page.text
    assert "as stated: 0.9" in page.text


def test_pictures_are_svg_with_alternative_texts(html, page):
    drawings = re.findall(r'src="data:image/svg\+xml;base64,([^"]*)"', html)
    assert len(drawings) == page.tags.count("img") == 3 + 4 * 2 + 1 + 1 + 2
    for drawing in drawings:
        decoded = base64.b64decode(drawing)
        assert decoded.startswith(b"<?xml")
        assert b"prefers-color-scheme" in decoded
        assert b"<script" not in decoded
        assert b"<img" not in decoded
    assert page.attributes.count("alt") == len(drawings)


def test_callsigns_cannot_become_markup(html, page, evil_callsign):
    assert evil_callsign not in html
    assert "&lt;img src=x onerror=alert(1)&gt;" in html
    assert "onerror" not in page.attributes
    assert f"{evil_callsign}, turn " in page.text


def test_report_contains_no_local_paths(html, reported):
    assert str(reported) not in html
    assert str(reported.parent) not in html


def test_second_report_replaces_the_first(run):
    assert "fewest possible" in Page(write_report(run).read_text()).text
    files = {path.name for path in run.iterdir()}
    (run / "bound.json").unlink()
    path = run / "results.json"
    path.write_text(re.sub(r'"train": \[\{.*?\}\]', '"train": []', path.read_text()))
    text = Page(write_report(run).read_text()).text
    assert "fewest possible" not in text
    assert "Thin lines are single seeds" not in text
    assert {path.name for path in run.iterdir()} == files - {"bound.json"}


def test_names_a_missing_table_and_writes_no_report(run):
    (run / "evaluation/lateral-s0-skystack-stacked/aircraft.parquet").unlink()
    with pytest.raises(InputError, match=r"aircraft\.parquet: missing"):
        write_report(run)
    assert not (run / "report.html").exists()
    assert not (run / "figures").exists()


@pytest.mark.slow
@pytest.mark.parametrize("obstacle", ["tables", "folder"])
def test_a_report_that_fails_changes_nothing(run, obstacle, monkeypatch):
    """Some faults of tables are noticed only when the replay is written, after the figures."""

    def refuse(*words, **options):
        raise InputError("its tables are from different evaluations")

    write_report(run)
    if obstacle == "tables":
        monkeypatch.setattr(report, "write_replay", refuse)
    else:
        (run / "results.md").unlink()
        (run / "results.md").mkdir()
    change_row(run, "lateral", clearances_mean=77.7)
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    with pytest.raises(InputError):
        write_report(run)
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_shows_other_simulators_only_if_used(run, page):
    path = run / "results.json"
    results = json.loads(path.read_text())
    theirs = results["rows"][0] | {"platform": "bluebird", "same_clearances_rate": 0.97}
    path.write_text(json.dumps(results | {"platforms": [results["rows"][0], theirs]}))
    updated = Page(write_report(run).read_text())
    assert "Other simulators" in updated.text
    assert "97.0 %" in updated.text
    assert "Other simulators" not in page.text


def test_shows_sampled_actions_if_there_are_any(run, page):
    path = run / "results.json"
    results = json.loads(path.read_text())
    sampled = results["rows"][0] | {"greedy": False, "clearances_mean": 77.7}
    path.write_text(json.dumps(results | {"sampled": [sampled]}))
    updated = Page(write_report(run).read_text())
    assert "#sampled" in updated.links
    assert "77.7 ±" in updated.text
    assert "77.7 ±" in (run / "results.md").read_text()
    assert "#sampled" not in page.links


def test_writes_the_tables_as_markdown(reported):
    text = (reported / "results.md").read_text()
    assert "## Lateral navigation" in text
    assert "| damped and stacked " in text
    assert "| fewest possible " in text
    assert "| clearances, success | seed 0 | seed 1 |" in re.sub(" +", " ", text)
