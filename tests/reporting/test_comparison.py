"""Comparisons of runs: as a page, as tables for the terminal, and as JSON."""

import io
import json

import pytest
from matplotlib.figure import Figure
from rich.console import Console

from skystack.cli import main
from skystack.errors import InputError
from skystack.reporting import comparison
from skystack.reporting.comparison import comparison_json, comparison_tables, write_comparison
from skystack.reporting.results import Update
from skystack.reporting.tables import NOTHING
from skystack.reporting.trainings import RunRow, Runs, TrainingRun, read_runs
from tests.reporting.rows import row
from tests.reporting.test_report import Page
from tests.reporting.test_trainings import write_training


@pytest.fixture
def runs(tmp_path, written):
    """A reproduction, a training with other settings, and one of another family."""
    return read_runs(
        [
            written,
            write_training(tmp_path / "<b>changed", "lateral", "ppo.gamma=0.9", seed=7),
            write_training(tmp_path / "climbs", "vertical", seed=1),
        ]
    )


@pytest.mark.slow
def test_page_shows_curves_trainings_rows_and_settings(runs, tmp_path):
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
    # A family with one training has no settings that differ.
    assert page.text.count("Settings that differ") == 1


def test_page_states_that_settings_are_the_same(tmp_path):
    folders = [write_training(tmp_path / name) for name in "ab"]
    write_comparison(read_runs(folders), tmp_path / "page.html")
    assert "the configurations are the same" in Page((tmp_path / "page.html").read_text()).text


def test_json_contains_trainings_rows_and_settings(runs):
    found = json.loads(json.dumps(comparison_json(runs)))
    assert [each["seed"] for each in found["train"]] == [0, 1, 0, 1, 7, 1]
    assert {(each["run"], each["experiment"], each["stacking"]) for each in found["rows"]} == {
        ("run", "lateral-undamped", False),
        ("run", "lateral", False),
        ("run", "lateral", True),
        ("run", "do-nothing-lateral", False),
    }
    assert found["settings"]["lateral"]["ppo.gamma"] == {
        "run, lateral-undamped": 0.99,
        "run, lateral": 0.99,
        "<b>changed": 0.9,
    }
    assert found["settings"]["vertical"] == {}


def test_terminal_tables(runs):
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
    output = io.StringIO()
    Console(file=output, width=300).print(settings.as_rich())
    assert "ppo.gamma" in output.getvalue()


def test_terminal_truncates_long_values_and_dashes_absent_ones(tmp_path):
    folders = [
        write_training(tmp_path / "a", "lateral"),
        write_training(tmp_path / "b", "lateral-best"),
    ]
    _, settings = comparison_tables(read_runs(folders))
    lines = {row[0]: row[1:] for row in settings.rows}
    assert lines["task.features"][0] == "theta_f, theta_sf, d_c, delta_t"
    assert lines["task.features"][1].endswith(" ...")
    assert lines["pretraining.steps"][0] == NOTHING


def test_unwritable_page_is_an_error(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_comparison(Runs([], []), tmp_path / "no" / "comparison.html")


def test_comparison_must_be_html(tmp_path, capsys):
    runs = [str(write_training(tmp_path / name)) for name in "ab"]
    assert main(["report", *runs, "-o", str(tmp_path / "page.pdf")]) == 2
    assert "page.pdf (allowed: .html)" in capsys.readouterr().err
    assert not (tmp_path / "page.pdf").exists()


def test_escapes_folder_names_that_are_not_utf_8(tmp_path):
    """On Linux, names are bytes, which need not be UTF-8."""
    runs = read_runs([write_training(tmp_path / name) for name in ("n\udcff", "m")])
    write_comparison(runs, tmp_path / "page.html")
    assert "n\\udcff" in (tmp_path / "page.html").read_text()


def learned(curve, experiment="lateral", seed=0, **settings):
    """A training of 101 updates, in which success rises by one point each, to 100 %."""
    updates = [
        Update(
            steps=20_000 * n,
            wall_s=50.0 * n,
            success=n / 100.0,
            instructions=200.0 - n,
            bursts=7.0,
            episodes=1.0,
        )
        for n in range(101)
    ]
    run = curve.partition(",")[0]
    return TrainingRun(curve, run, experiment, seed, updates, settings)


@pytest.fixture
def two_runs():
    """Two runs, made by hand. Vertical control was only trained, avoidance only evaluated."""
    trainings = [
        learned("a, lateral", seed=1, gamma=0.9, batch=0, greedy=False, layers=["x", 2]),
        learned("a, lateral", seed=2, gamma=0.9, batch=0, greedy=False, layers=["x", 2]),
        learned("a, lateral-best", "lateral-best", seed=3, gamma=0.8),
        learned("b", "vertical", seed=None),
    ]
    rows = [RunRow("a", row()), RunRow("b", row(experiment="avoidance"))]
    return Runs(trainings, rows)


def test_training_figures_are_the_ends_of_running_means(two_runs):
    """The last three updates are in the window: 98 to 100 % success, 102 to 100 instructions."""
    trainings, *_ = comparison_tables(two_runs)
    assert trainings.header == (
        *("run", "experiment", "seed"),
        *("steps", "time", "success", "instructions"),
    )
    ends = ("2,000,000", "1 h 23 min", "99.0 %", "101.0")
    assert trainings.rows == (
        ("a", "lateral", "1", *ends),
        ("a", "lateral", "2", *ends),
        ("a", "lateral-best", "3", *ends),
        ("b", "vertical", NOTHING, *ends),
    )


def test_each_row_names_its_run(two_runs):
    _, rows, _ = comparison_tables(two_runs)
    assert [line[:2] for line in rows.rows] == [
        ("damped and stacked", "a"),
        ("avoidance, stacked", "b"),
    ]


def test_settings_have_one_column_per_curve(two_runs):
    *_, settings = comparison_tables(two_runs)
    assert settings.header == ("setting", "a, lateral", "a, lateral-best")
    assert settings.rows == (
        ("gamma", "0.9", "0.8"),
        ("batch", "0", NOTHING),
        ("greedy", "false", NOTHING),
        ("layers", "x, 2", NOTHING),
    )
    assert list(comparison_json(two_runs)["settings"]) == ["lateral", "vertical", "avoidance"]


def test_each_family_has_its_own_trainings_rows_and_curves(two_runs, tmp_path, monkeypatch):
    drawn = []

    def draw(curves):
        drawn.append({name: len(seeds) for name, seeds in curves.items()})
        return Figure((1.0, 1.0))

    monkeypatch.setattr(comparison, "overlaid_curves", draw)
    write_comparison(two_runs, tmp_path / "page.html")
    assert drawn == [{"a, lateral": 2, "a, lateral-best": 1}, {"b": 1}]
    _, *sections = (tmp_path / "page.html").read_text().split("<h2>")
    lateral, vertical, avoidance = (Page(section).text for section in sections)
    for text, own, others in (
        (lateral, ["damped and stacked", "lateral-best"], ["avoidance, stacked", "vertical"]),
        (vertical, ["vertical"], ["damped and stacked", "lateral-best", "avoidance, stacked"]),
        (avoidance, ["avoidance, stacked"], ["damped and stacked", "lateral-best", "vertical"]),
    ):
        assert all(name in text for name in own)
        assert not any(name in text for name in others)


def test_terminal_values_have_at_most_40_characters():
    names = ["word " * 7 + "12345", "word " * 7 + "123456"]
    runs = Runs([learned(name, text=name) for name in names], [])
    _, settings = comparison_tables(runs)
    assert settings.rows[0][1] == names[0]  # 40
    assert settings.rows[0][2] == "word " * 6 + "word ..."
