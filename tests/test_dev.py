"""`dev.py` prepares its environment only when that is needed, and runs the tests asked for."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def dev():
    spec = importlib.util.spec_from_file_location("dev", ROOT / "dev.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def prepared(dev, monkeypatch, tmp_path):
    """Runs `prepare` in an empty folder; returns what it does, without doing it."""
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


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], ["pytest -m not slow"]),
        (["-x", "-k", "pairs"], ["pytest -m not slow -x -k pairs"]),
        (["tests/tasks", "-x"], ["pytest tests/tasks -x"]),
        (["tests/test_dev.py::test_it"], ["pytest tests/test_dev.py::test_it"]),
        (["--all"], ["pytest --cov --cov-report=", *["coverage report"] * 4]),
        (["-x", "--all"], ["pytest --cov --cov-report= -x", *["coverage report"] * 4]),
    ],
)
def test_slow_tests_and_coverage_are_run_on_request(dev, monkeypatch, arguments, expected):
    ran = []
    monkeypatch.setattr(dev, "prepare", lambda *_: None)
    monkeypatch.setattr(dev, "keep_programs", lambda: None)
    monkeypatch.setattr(dev, "run", lambda *command: ran.append(" ".join(command)) or 0)
    assert dev.main(["test", *arguments]) == 0
    assert len(ran) == len(expected)
    assert all(command.startswith(start) for command, start in zip(ran, expected, strict=True))


@pytest.mark.parametrize(("pytest_code", "coverage_code"), [(1, 0), (0, 2), (1, 2)])
def test_failed_tests_or_low_coverage_are_a_failure(dev, monkeypatch, pytest_code, coverage_code):
    monkeypatch.setattr(dev, "prepare", lambda *_: None)
    monkeypatch.setattr(dev, "keep_programs", lambda: None)
    codes = {"pytest": pytest_code, "coverage": coverage_code}
    monkeypatch.setattr(dev, "run", lambda module, *_: codes[module])
    assert dev.main(["test", "--all"]) == (pytest_code or coverage_code)
