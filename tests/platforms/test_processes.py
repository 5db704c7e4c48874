"""Work in other processes: what comes of each item, and where it is done."""

import os

import pytest

pytest.importorskip("pebble")

from skystack.errors import InputError
from skystack.platforms import processes
from skystack.platforms.processes import in_processes

from .workers import make, make_and_die, make_badly, make_nothing

LONG_S = 300.0
"""No item takes that long: no limit of time is tried here."""


def test_every_item_is_done_or_has_failed_for_a_reason_of_its_own(tmp_path, monkeypatch):
    """Each process has a folder of its own, and there are no more of them than cores."""
    monkeypatch.setattr(processes, "cores", lambda: [0, 1])
    outcomes = list(in_processes(make, ["a", "lost", "b", "dies", "c"], tmp_path, LONG_S))
    died = "the simulator's process died (exit code 7)"
    assert [outcome.failed for outcome in outcomes] == [None, "lost AC1", None, died, None]
    results = [outcome.result for outcome in outcomes if outcome.failed is None]
    assert [result[0] for result in results] == ["A", "B", "C"]
    folders = {(folder, process) for _, folder, process in results}
    assert len({folder for folder, _ in folders}) == len(folders)
    assert all((folder / "made").exists() for folder, _ in folders)
    assert {folder.parent for folder, _ in folders} == {tmp_path}
    assert os.getpid() not in {process for _, process in folders}
    assert len(list(tmp_path.iterdir())) <= 3  # two, and one in place of the one that died


@pytest.mark.parametrize(("work", "message"), [(make, "fl is 3"), (make_nothing, "no such plat")])
def test_an_input_error_ends_all_work(work, message, tmp_path):
    with pytest.raises(InputError, match=f"^{message}"):
        list(in_processes(work, ["wrong"], tmp_path, LONG_S))


def test_what_does_not_start_is_named_in_one_line(tmp_path):
    (outcome,) = in_processes(make_badly, ["a"], tmp_path, LONG_S)
    assert outcome == (None, "did not start: ValueError: two lines")


def test_what_takes_longer_than_its_limit_is_given_up(tmp_path):
    """Ten minutes against a second: however slow the machine."""
    (outcome,) = in_processes(make, ["hangs"], tmp_path, 1.0)
    assert outcome == (None, "took more than 1 s")


def test_no_item_is_done_by_processes_that_die_while_starting(tmp_path):
    outcomes = list(in_processes(make_and_die, ["a", "b", "c"], tmp_path, LONG_S))
    assert outcomes == [(None, "its process died, or took too long, while starting")] * 3
