"""The report on hours of traffic: its table, its page and its errors."""

import msgspec
import pytest

from skystack.cli import main
from skystack.errors import InputError
from skystack.evaluation.hour_row import write_row
from skystack.reporting.hours_report import (
    hours_table,
    label,
    ranges,
    read_hours,
    write_hours_report,
)
from tests.reporting.rows import hour_row


def stored(folder, *rows):
    for number, row in enumerate(rows):
        (folder / str(number)).mkdir(parents=True)
        write_row(folder / str(number), msgspec.to_builtins(row))
    return folder


def test_a_line_of_the_table_has_the_figures_of_a_row():
    found = hours_table([hour_row("search", "60")])
    assert dict(zip(found.header, found.rows[0], strict=True)) == {
        "controller": "search",
        "traffic": "60",
        "hours": "2",
        "flights": "1,234",
        "losses of separation (at birth)": "3 (1)",
        "correct exits": "98.7 %",
        "excursions": "0.1 %",
        "transmissions per flight": "2.35",
        "worst minute": "10",
        "fail-safe": "91.0 %",
        "extra distance": "1.2 %",
        "lax score, s": "3,457",
        "strict score, s": "1,234",
        "decision, ms": "4.6",
    }


def test_seeds_that_failed_are_shown():
    (line,) = hours_table([hour_row("search", "60", failed_seeds=[4, 9])]).rows
    assert line[2] == "2 (+ 2 failed)"


@pytest.mark.parametrize(("hours", "words"), [(20.0, "20"), (100 / 600, "0.167"), (1234.0, "1234")])
def test_hours_are_rounded_to_thousandths(hours, words):
    row = msgspec.structs.replace(hour_row("search", "60"), hours=hours)
    assert hours_table([row]).rows[0][2] == words


def test_names_tell_what_differs_from_the_defaults():
    assert label(hour_row("learned", "60", safety_net=True)) == "learned"
    changed = hour_row("learned", "60", safety_net=False, per_cycle=1, uncertainty=True)
    assert label(changed) == "learned, no safety net, 1 per cycle, uncertainty"
    assert label(hour_row("learned", "category", platform="bluebird")) == "learned, in bluebird"
    assert label(hour_row("learned", "60", cycles=30)) == "learned, 30 cycles"
    assert label(hour_row("learned", "head-on.json", cycles=150)) == "learned"


def test_rows_are_in_order_of_the_traffic(tmp_path):
    rows = [
        hour_row("b", "60"),
        hour_row("a", "category"),
        hour_row("a", "200"),
        hour_row("a", "30"),
    ]
    found = read_hours([stored(tmp_path, *rows)])
    assert [(row.agent, row.traffic) for row in found] == [
        ("a", "30"), ("a", "200"), ("a", "category"), ("b", "60")
    ]  # fmt: skip


def test_the_page_has_both_figures_and_the_table(tmp_path):
    rows = [
        hour_row("<b>agent\0", "30"),
        hour_row("<b>agent\0", "60"),
        hour_row("other", "category"),
    ]
    write_hours_report(rows, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert page.count("<img") == 2
    assert "&lt;b&gt;agent" in page
    assert "<b>agent" not in page
    assert "\0" not in page
    write_hours_report(rows[2:], tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text().count("<img") == 1  # no traffic has a rate


@pytest.mark.slow
def test_the_verb_writes_the_page(tmp_path, capsys):
    folder = stored(tmp_path / "hours", hour_row("search", "60"))
    page = tmp_path / "page.html"
    assert main(["report", str(folder), "-o", str(page)]) == 0
    assert page.exists()
    shown = capsys.readouterr()
    assert "search" in shown.out
    assert f"report: {page}" in shown.err
    assert main(["report", str(folder), "-o", str(page), "--json"]) == 0
    assert '"agent":"search"' in capsys.readouterr().out.replace(" ", "")
    assert main(["report", str(folder), "-o", str(tmp_path / "page.pdf")]) == 2
    assert "allowed: .html" in capsys.readouterr().err


def test_a_folder_that_is_given_twice_counts_once(tmp_path):
    folder = stored(tmp_path / "hours", hour_row("search", "60"))
    assert len(read_hours([folder, folder / "0"])) == 1


def test_hours_of_different_sectors_are_refused(tmp_path):
    folder = stored(
        tmp_path / "hours", hour_row("search", "60"), hour_row("search", "60", sector="merge")
    )
    with pytest.raises(InputError, match="different sectors: merge, x-plus"):
        read_hours([folder])


def test_folders_without_hours_are_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="contains no hours of traffic"):
        read_hours([stored(tmp_path / "hours", hour_row("search", "60")), tmp_path / "empty"])


def test_seeds_are_listed_as_ranges():
    assert ranges([1, 2, 5, 6, 7, 9]) == ["1", "2", "5 to 7", "9"]
    assert ranges([]) == []


def test_a_row_of_several_seeds_lists_them(tmp_path):
    rows = [hour_row("learned", "60", seed_numbers=[3, 4, 5])]
    write_hours_report(rows, tmp_path / "hours.html")
    assert "seeds 3 to 5" in (tmp_path / "hours.html").read_text()
