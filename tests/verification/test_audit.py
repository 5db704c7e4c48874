"""What is read, written, executed or unpickled beside what was asked for is noticed."""

import os
import pickle
import subprocess
import sys

import pytest

from verification.inputs.audit import watched


@pytest.fixture
def asked(tmp_path):
    (tmp_path / "secret").write_text("x")
    folder = tmp_path / "asked"
    folder.mkdir()
    (folder / "known").write_text("x")
    (folder / "link").symlink_to(tmp_path / "secret")
    return folder


@pytest.mark.parametrize(
    ("act", "found"),
    [
        (lambda asked: (asked / "known").read_text(), None),
        (lambda asked: list(asked.iterdir()), None),
        (lambda asked: (asked / "../secret").read_text(), "open"),
        (lambda asked: (asked / "link").read_text(), "open"),
        (lambda asked: list(asked.parent.iterdir()), "os.listdir"),
        (lambda asked: (asked / "new").write_text("x"), "open to write"),
        (lambda asked: (asked / "known").unlink(), "os.remove to write"),
        (lambda asked: (asked / "a").mkdir(), "os.mkdir to write"),
        (lambda asked: (asked / "known").rename(asked.parent / "b"), "os.rename to write"),
        (lambda asked: subprocess.run([sys.executable, "-c", ""], check=True), "subprocess.Popen"),
        (lambda asked: pickle.loads(pickle.dumps(os.getcwd)), "pickle.find_class"),
    ],
)
def test_accesses_are_detected(asked, act, found):
    with watched(asked) as watch:
        act(asked)
    first = watch.found[0].rpartition(" ")[0] if watch.found else None
    assert first == found or (first or "").startswith(f"{found} ")


def test_the_folder_may_be_written_to_where_that_is_asked_for(asked):
    with watched(asked, writes=True) as watch:
        (asked / "new").write_text("x")
        assert not watch.found
        (asked.parent / "new").write_text("x")
    assert watch.found == [f"open to write {asked.parent / 'new'}"]


def test_nothing_is_detected_after_the_context(asked):
    with watched(asked) as watch:
        pass
    (asked / "new").write_text("x")
    assert not watch.found
