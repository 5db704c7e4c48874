"""Work in separate processes: results, failures, folders and the time limit."""

import os

import pytest

pytest.importorskip("pebble")

from skystack.errors import InputError
from skystack.platforms import processes
from skystack.platforms.processes import in_processes

from .workers import make, make_and_die, make_with_input_error, make_with_value_error

NO_LIMIT_S = 300.0
"""A time limit that no item reaches."""


def test_each_item_has_a_result_or_its_own_failure(tmp_path, monkeypatch):
    """Each process has its own folder, and there are at most as many processes as cores."""
    monkeypatch.setattr(processes, "cores", lambda: [0, 1])
    outcomes = list(in_processes(make, ["a", "lost", "b", "dies", "c"], tmp_path, NO_LIMIT_S))
    died = "the simulator's process died (exit code 7)"
    assert [outcome.failed for outcome in outcomes] == [None, "lost AC1", None, died, None]
    results = [outcome.result for outcome in outcomes if outcome.failed is None]
    assert [result[0] for result in results] == ["A", "B", "C"]
    folders = {(folder, process) for _, folder, process in results}
    assert len({folder for folder, _ in folders}) == len(folders)
    assert all((folder / "made").exists() for folder, _ in folders)
    assert {folder.parent for folder, _ in folders} == {tmp_path}
    assert os.getpid() not in {process for _, process in folders}
    assert len(list(tmp_path.iterdir())) <= 3  # two, and one that replaces the process that died


@pytest.mark.parametrize(
    ("work", "message"), [(make, "fl is 3"), (make_with_input_error, "no such plat")]
)
def test_an_input_error_ends_all_work(work, message, tmp_path):
    with pytest.raises(InputError, match=f"^{message}"):
        list(in_processes(work, ["wrong"], tmp_path, NO_LIMIT_S))


def test_startup_errors_are_one_line(tmp_path):
    (outcome,) = in_processes(make_with_value_error, ["a"], tmp_path, NO_LIMIT_S)
    assert outcome == (None, "did not start: ValueError: two lines")


def test_items_beyond_the_time_limit_fail(tmp_path):
    """The item takes ten minutes and the limit is one second, however slow the machine is."""
    (outcome,) = in_processes(make, ["hangs"], tmp_path, 1.0)
    assert outcome == (None, "took more than 1 s")


def test_items_fail_if_processes_die_while_starting(tmp_path):
    outcomes = list(in_processes(make_and_die, ["a", "b", "c"], tmp_path, NO_LIMIT_S))
    assert outcomes == [(None, "its process died, or took too long, while starting")] * 3
