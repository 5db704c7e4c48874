"""`dev.py` creates its environment once, and updates it only when that is needed."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def prepared(monkeypatch, tmp_path):
    """Runs `prepare` in an empty folder; returns what it does, without doing it."""
    spec = importlib.util.spec_from_file_location("dev", ROOT / "dev.py")
    dev = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(dev)
    done = []

    def create(environment, **_):
        done.append("create")
        dev.PYTHON.parent.mkdir(parents=True, exist_ok=True)
        dev.PYTHON.touch()

    monkeypatch.setattr(dev, "ENVIRONMENT", tmp_path)
    monkeypatch.setattr(dev, "PYTHON", tmp_path / "bin" / "python")
    monkeypatch.setattr(dev.venv, "create", create)
    monkeypatch.setattr(dev.subprocess, "run", lambda *_, **__: done.append("install"))

    def run(*extras):
        done.clear()
        dev.prepare(*extras)
        return list(done)

    return run


def test_an_environment_is_created_once(prepared):
    assert prepared() == ["create", "install"]
    assert prepared() == []
    assert prepared("test") == ["install"]
    assert prepared("test") == []


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda stamp: f"3.1 {stamp.split()[1]}", ["create", "install"]),  # another Python
        (lambda stamp: stamp.split()[1], ["create", "install"]),  # an earlier form of the file
        (lambda stamp: f"{stamp.split()[0]} 0123", ["install"]),  # other requirements
    ],
)
def test_only_what_a_change_requires_is_done(prepared, tmp_path, change, expected):
    prepared()
    stamp = tmp_path / "requirements.txt"
    stamp.write_text(change(stamp.read_text()))
    assert prepared() == expected
    assert prepared() == []


def test_an_environment_without_python_is_created_again(prepared, tmp_path):
    prepared()
    (tmp_path / "bin" / "python").unlink()
    assert prepared() == ["create", "install"]
