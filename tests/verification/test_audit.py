"""Forbidden reads, writes, executions and unpickling are detected."""

import os
import pickle
import subprocess
import sys

import pytest

from verification.inputs.audit import watched


@pytest.fixture
def allowed(tmp_path):
    (tmp_path / "secret").write_text("x")
    folder = tmp_path / "allowed"
    folder.mkdir()
    (folder / "known").write_text("x")
    (folder / "link").symlink_to(tmp_path / "secret")
    return folder


@pytest.mark.parametrize(
    ("access", "event"),
    [
        (lambda allowed: (allowed / "known").read_text(), None),
        (lambda allowed: list(allowed.iterdir()), None),
        (lambda allowed: (allowed / "../secret").read_text(), "open"),
        (lambda allowed: (allowed / "link").read_text(), "open"),
        (lambda allowed: list(allowed.parent.iterdir()), "os.listdir"),
        (lambda allowed: (allowed / "new").write_text("x"), "open to write"),
        (lambda allowed: (allowed / "known").unlink(), "os.remove to write"),
        (lambda allowed: (allowed / "a").mkdir(), "os.mkdir to write"),
        (lambda allowed: (allowed / "known").rename(allowed.parent / "b"), "os.rename to write"),
        (
            lambda allowed: subprocess.run([sys.executable, "-c", ""], check=True),
            "subprocess.Popen",
        ),
        (lambda allowed: pickle.loads(pickle.dumps(os.getcwd)), "pickle.find_class"),
    ],
)
def test_detects_forbidden_accesses(allowed, access, event):
    with watched(allowed) as watch:
        access(allowed)
    first = watch.found[0].rpartition(" ")[0] if watch.found else None
    assert first == event or (first or "").startswith(f"{event} ")


def test_allows_writing_in_the_folder_on_request(allowed):
    with watched(allowed, writes=True) as watch:
        (allowed / "new").write_text("x")
        assert not watch.found
        (allowed.parent / "new").write_text("x")
    assert watch.found == [f"open to write {allowed.parent / 'new'}"]


def test_nothing_is_detected_after_the_context(allowed):
    with watched(allowed) as watch:
        pass
    (allowed / "new").write_text("x")
    assert not watch.found
