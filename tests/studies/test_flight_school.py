"""The study of Flight School: what it flies, its tables and its figure."""

from functools import partial

import pytest

from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.reporting.flight_school_table import comparison
from skystack.reporting.tables import NOTHING
from studies import flight_school
from studies.flight_school import Case
from studies.hour_results import RESULTS, read_results, write_results
from tests.studies.test_hour_results import result


def test_flies_every_controller_on_every_traffic():
    plan = flight_school.plan()
    assert len(plan) == len(set(plan)) == 2 * 3 * 6 + 7
    assert Case("mvp", "category", "bluesky") in plan
    assert not [each for each in plan if each.agent == "mvp" and each.platform != "bluesky"]


def test_names_select_the_cases_that_match_all_of_them():
    assert flight_school.named([]) == flight_school.plan()
    found = flight_school.named(["bluebird", "search"])
    assert {each.traffic for each in found} == {"category", "notebook", "environment"}
    assert {(each.agent, each.platform) for each in found} == {("search", "bluebird")}


@pytest.fixture
def short(monkeypatch):
    """Short hours of one controller."""
    monkeypatch.setattr(flight_school, "plan", lambda: [Case("no-op", "category", "skystack")])
    monkeypatch.setattr(flight_school, "TrafficConditions", partial(TrafficConditions, cycles=20))


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_flies_prints_and_draws(tmp_path, capsys, monkeypatch):
    where = ["--out", str(tmp_path), "--results", str(tmp_path / "results.jsonl")]
    assert flight_school.main(["--seeds", "2", *where]) == 0
    assert "### `category` in skystack" in (out := capsys.readouterr().out)
    assert "| no-op" in out
    assert (tmp_path / "flight-school.png").exists()
    # What is stored is not flown again, unless another number of seeds is asked for.
    monkeypatch.setattr(flight_school, "fly", lambda *_: pytest.fail("flies again"))
    assert flight_school.main(["--seeds", "2", *where]) == 0
    assert capsys.readouterr().out == out
    assert flight_school.main(["--read", *where]) == 0
    assert capsys.readouterr().out == out
    with pytest.raises(pytest.fail.Exception):
        flight_school.main(["--seeds", "3", *where])


@pytest.mark.usefixtures("short")
def test_other_stored_results_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(
        flight_school, "fly", lambda *_: (result("no-op", "category", "skystack"), [])
    )
    path = tmp_path / "results.jsonl"
    other = result("search", "120", "skystack")
    write_results(path, [other])
    assert flight_school.main(["--out", str(tmp_path), "--results", str(path)]) == 0
    assert read_results(path) == [result("no-op", "category", "skystack"), other]


@pytest.mark.usefixtures("short")
def test_seeds_that_fail_are_reported_and_flown_again(tmp_path, capsys, monkeypatch):
    def fly(_case, seeds, _out):
        seen.append(seeds)
        return result("no-op", "category", "skystack"), ["seed 2, no answer"] * (len(seen) == 1)

    seen = []
    monkeypatch.setattr(flight_school, "fly", fly)
    where = ["--out", str(tmp_path), "--results", str(tmp_path / "results.jsonl")]
    assert flight_school.main(["--seeds", "2", *where]) == 1
    captured = capsys.readouterr()
    assert captured.err.splitlines()[1] == "no-op category skystack: seed 2, no answer"
    assert "| no-op" in captured.out
    assert flight_school.main(["--seeds", "2", *where]) == 0
    assert seen == [2, 2]


def test_the_best_controller_comes_first(tmp_path, capsys):
    results = [
        result(agent, "category", "skystack", lax_s_mean=score)
        for agent, score in (("rules", 900.0), ("search", 3100.0))
    ]
    write_results(tmp_path / "results", results)
    where = ["--results", str(tmp_path / "results"), "--out", str(tmp_path)]
    assert flight_school.main(["--read", *where]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines if line.startswith("| ")][1:] == ["search", "rules"]


def test_compares_skystack_with_bluebird():
    def row(agent, traffic, platform, *scores):
        values = {"lax_s_by_hour": scores, "lax_s_mean": sum(scores) / len(scores)}
        return result(agent, traffic, platform, **values).hour_row

    rows = [
        row("rules", "category", "skystack", 1010.0, 1290.0, 1000.0),
        row("rules", "category", "bluebird", 990.0, 1003.0, 1006.0, 1001.0),
        row("search", "notebook", "skystack", 3600.0, 3600.0),
        row("search", "notebook", "bluebird", 3600.0, 3600.0),
        row("no-op", "category", "skystack", 600.0, 700.0),
    ]
    # U is 4 + 4 + 1 = 9 of 12. In 7 of the 35 orders it is at least 9, so p is 14 / 35.
    assert flight_school.agreement(rows).rows == (
        ("category: rules", "1,100", "1,000", "+10.0 %", "0.40"),
        ("notebook: search", "3,600", "3,600", "+0.0 %", NOTHING),
    )


@pytest.mark.usefixtures("short")
def test_results_that_another_run_has_stored_are_kept(tmp_path, monkeypatch):
    path, other = tmp_path / "results.jsonl", result("search", "120", "skystack")

    def fly(*_):
        write_results(path, [other])
        return result("no-op", "category", "skystack"), []

    monkeypatch.setattr(flight_school, "fly", fly)
    assert flight_school.main(["--out", str(tmp_path), "--results", str(path)]) == 0
    assert read_results(path) == [result("no-op", "category", "skystack"), other]


@pytest.mark.usefixtures("short")
def test_an_interruption_is_one_line(tmp_path, capsys, monkeypatch):
    def fly(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(flight_school, "fly", fly)
    where = ["--out", str(tmp_path), "--results", str(tmp_path / "results.jsonl")]
    assert flight_school.main(where) == 130
    assert capsys.readouterr().err == "interrupted: run the same command again to resume\n"


@pytest.mark.parametrize(
    "arguments",
    [["--read"], ["--seeds", "0"], ["--others", "0"], ["serch"], ["search", "rules"]],
)
def test_mistakes_are_one_line(tmp_path, capsys, arguments):
    where = ["--results", str(tmp_path / "results"), "--out", str(tmp_path / "out")]
    assert flight_school.main([*arguments, *where]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_documentation_shows_all_stored_results():
    page = (RESULTS.parent.parent / "flight-school.md").read_text()
    shown = {tuple(map(str.strip, line.split("|")[1:-1])) for line in page.splitlines()}
    lines = [comparison([each.hour_row]).rows[0] for each in read_results(RESULTS)]
    assert [line for line in lines if line not in shown] == []
