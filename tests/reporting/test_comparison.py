"""Runs side by side: what the page, the terminal and programs are told."""

import io
import json

import pytest
from rich.console import Console

from skystack.errors import InputError
from skystack.reporting.comparison import comparison_json, comparison_tables, write_comparison
from skystack.reporting.tables import NOTHING
from skystack.reporting.trainings import read_runs
from tests.reporting.test_report import Page
from tests.reporting.test_trainings import write_training


@pytest.fixture
def runs(tmp_path, reported):
    """A reproduction, one training with other settings, one of another family."""
    return read_runs(
        [
            reported,
            write_training(tmp_path / "<b>changed", "lateral", "ppo.gamma=0.9", seed=7),
            write_training(tmp_path / "climbs", "vertical", seed=1),
        ]
    )


def test_the_page_shows_curves_trainings_rows_and_settings_by_family(runs, tmp_path):
    path = tmp_path / "comparison.html"
    write_comparison(runs, path)
    html = path.read_text()
    page = Page(html)
    for text in ("Lateral navigation", "Vertical control", "damped and stacked", "ppo.gamma"):
        assert text in page.text
    assert "<b>changed" in page.text
    assert "<b>changed" not in html
    assert page.tags.count("img") == 2
    assert all(address.startswith("data:image/svg+xml;base64,") for address in page.addresses)
    assert "http" not in html
    assert str(tmp_path.parent) not in html
    # One training has nothing to differ from.
    assert page.text.count("What was set differently") == 1


def test_the_same_settings_are_said_to_be_the_same(tmp_path):
    folders = [write_training(tmp_path / name) for name in "ab"]
    write_comparison(read_runs(folders), tmp_path / "page.html")
    assert "the configurations are the same" in Page((tmp_path / "page.html").read_text()).text


def test_programs_are_told_the_same(runs):
    found = json.loads(json.dumps(comparison_json(runs)))
    assert [each["seed"] for each in found["train"]] == [0, 1, 0, 1, 7, 1]
    assert {(each["run"], each["experiment"], each["stacking"]) for each in found["rows"]} == {
        ("run", "lateral-undamped", False),
        ("run", "lateral", False),
        ("run", "lateral", True),
        ("run", "do-nothing", False),
    }
    assert found["settings"]["lateral"]["ppo.gamma"] == {
        "run, lateral-undamped": 0.99,
        "run, lateral": 0.99,
        "<b>changed": 0.9,
    }
    assert found["settings"]["vertical"] == {}


def test_tables_for_the_terminal(runs):
    trainings, rows, settings = comparison_tables(runs)
    assert trainings.rows[-2] == (
        "<b>changed",
        "lateral",
        "7",
        "768",
        "6 s",
        "75.0 %",
        "12.0",
    )
    assert rows.header[:4] == ("row", "run", "paper", "clearances")
    assert rows.rows[2][:3] == ("damped and stacked", "run", "7.2 ± 3.5")
    lines = {row[0]: row[1:] for row in settings.rows}
    assert lines["ppo.gamma"] == ("0.99", "0.99", "0.9")
    written = io.StringIO()
    Console(file=written, width=300).print(settings.as_rich())
    assert "ppo.gamma" in written.getvalue()


def test_long_values_are_cut_in_the_terminal_and_absent_ones_a_dash(tmp_path):
    folders = [
        write_training(tmp_path / "a", "lateral"),
        write_training(tmp_path / "b", "lateral-best"),
    ]
    _, settings = comparison_tables(read_runs(folders))
    lines = {row[0]: row[1:] for row in settings.rows}
    assert lines["task.features"][0] == "theta_f, theta_sf, d_c, delta_t"
    assert lines["task.features"][1].endswith(" ...")
    assert lines["pretraining.steps"][0] == NOTHING


def test_a_page_that_cannot_be_written_is_an_error(runs, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_comparison(runs, tmp_path / "no" / "comparison.html")
