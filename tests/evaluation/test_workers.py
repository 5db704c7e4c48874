"""Items in worker processes: results, reports, failures and the limit between reports."""

import os
from contextlib import closing
from pathlib import Path

import pytest

from skystack.evaluation import workers
from skystack.evaluation.workers import run_in_workers
from tests.waiting import wait_until

from .seed_workers import make, make_and_die

NO_LIMIT_S = 600.0
"""A limit that no item reaches."""


@pytest.fixture(autouse=True)
def two_cores(monkeypatch):
    """Two workers, wherever they run."""
    monkeypatch.setattr(workers, "cores", lambda: [None, None])


@pytest.mark.slow
def test_each_item_has_a_result_or_its_own_failure(capfd):
    reports = []
    items = ["a", "wrong", "dies", "b", "bug", "c"]
    finished = {
        each.item: each
        for each in run_in_workers(make, items, NO_LIMIT_S, lambda *told: reports.append(told))
    }
    assert list(map(finished.__contains__, items)) == [True] * len(items)
    results = [finished[item].result for item in ("a", "b", "c")]
    assert [result[0] for result in results] == ["A", "B", "C"]
    assert os.getpid() not in {process for _, process in results}
    assert {item: finished[item].failed for item in ("wrong", "dies", "bug")} == {
        "wrong": "AC1 has left",
        "dies": "cycle 0: its process died (exit code 7)",
        "bug": "cycle 0: its process died (exit code 1)",
    }
    assert [told for told in reports if told[0] == "b"] == [("b", "cycle 0"), ("b", "cycle 1")]
    out, err = capfd.readouterr()
    assert (out, err.count("printed")) == ("", 3)
    assert "KeyError: 'bug'" in err


@pytest.mark.slow
def test_each_item_may_have_its_own_process():
    items = ["a", "b", "c", "wrong", "d"]
    finished = list(run_in_workers(make, items, NO_LIMIT_S, process_per_item=True))
    assert {each.item for each in finished} == set(items)
    processes = [each.result[1] for each in finished if each.failed is None]
    assert len(set(processes)) == len(processes) == 4


def test_an_item_that_reports_nothing_for_too_long_fails():
    """The item takes ten minutes and the limit is one second, however slow the machine is."""
    (finished,) = run_in_workers(make, ["hangs"], 1.0)
    assert finished == ("hangs", None, "cycle 0: took longer than 1 s")


@pytest.mark.skipif(not hasattr(os, "setsid"), reason="has no process groups")
def test_what_the_work_has_started_ends_with_the_worker():
    """A process that would run for ten minutes is gone, and a thread does not delay the end."""
    items = ["leaves a process", "leaves a thread"]
    started = {each.item: each.result for each in run_in_workers(make, items, NO_LIMIT_S)}
    pid, _ = started["leaves a process"]
    wait_until(lambda: not is_running(pid))


def is_running(pid):
    """Whether a process runs; one that has ended but was not collected does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
def test_items_fail_if_workers_die_while_starting():
    finished = list(run_in_workers(make_and_die, ["a", "b", "c"], NO_LIMIT_S))
    assert sorted(each.item for each in finished) == ["a", "b", "c"]
    assert {each.failed for each in finished} == {"its process died (exit code 9)"}


def test_workers_end_when_the_results_are_not_wanted(monkeypatch):
    started = []
    original = workers._Worker.give
    monkeypatch.setattr(
        workers._Worker, "give", lambda self, item: (started.append(self), original(self, item))
    )
    with closing(run_in_workers(make, ["a", "hangs"], NO_LIMIT_S)) as finished:
        assert next(finished).item == "a"
    assert not any(each.process.is_alive() for each in started)
