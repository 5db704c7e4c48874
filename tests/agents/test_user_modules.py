"""The classes of users' controllers, and their files."""

import importlib
import subprocess
import sys
from hashlib import sha256

import pytest

from skystack.agents.user_modules import (
    find_user_code,
    is_user_code,
    user_code_file,
)
from skystack.errors import InputError


@pytest.mark.parametrize(
    ("name", "is_code"),
    [
        ("mine:Mine", True),
        ("a.b:Mine", True),
        ("folder/mine.py:Mine", True),
        ("search", False),
        (":Mine", False),
        ("mine:", False),
        ("runs/a:b/policy", False),
        ("model.onnx", False),
    ],
)
def test_names_of_classes(name, is_code):
    assert is_user_code(name) == is_code


def test_finds_a_class_in_a_module_or_a_file(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    source = (
        "class Mine:\n    def generate_action(self, env, observation, info):\n        return {}\n"
    )
    (tmp_path / "mine_here.py").write_text(source)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine_there.py").write_text(source)
    assert find_user_code("mine_here:Mine").__name__ == "Mine"
    assert find_user_code("other/mine_there.py:Mine")().generate_action(1, 2, 3) == {}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no_such_module:Mine", "no_such_module:Mine: cannot be imported: ModuleNotFoundError"),
        ("no_such_file.py:Mine", "no_such_file.py:Mine: no_such_file.py does not exist or is not"),
        ("tests.agents.user_controllers:Mine", "there is no Mine in tests.agents.user_controllers"),
        ("tests.agents.user_controllers:Silent", "Silent is not a class with a method generate_"),
        ("tests.agents.user_controllers:os", "os is not a class with a method generate_action"),
    ],
)
def test_wrong_names_are_one_line(name, message):
    with pytest.raises(InputError, match=message):
        find_user_code(name)


def test_a_module_that_fails_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken_module.py").write_text("x = 1\nraise SystemExit('stop')\n")
    with pytest.raises(InputError, match=r"SystemExit: stop \(broken_module.py, line 2\)$"):
        find_user_code("broken_module:Mine")


def test_a_file_may_have_the_name_of_a_module(tmp_path, monkeypatch):
    """It is executed itself, and does not replace the module for anybody else."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    source = "class Mine:\n    def generate_action(self, *given):\n        return {}\n"
    for name in ("json.py", "my.agent.py", "queue.py"):
        (tmp_path / name).write_text(source)
        assert find_user_code(f"{tmp_path / name}:Mine").__name__ == "Mine"
    assert hasattr(importlib.import_module("json"), "JSONEncoder")
    assert sys.path[-1] == str(tmp_path)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("raise KeyboardInterrupt", r"KeyboardInterrupt \(bad_file.py, line 1\)$"),
        ("class Odd(BaseException): pass\nraise Odd('b')", r"Odd: b \(bad_file.py, line 2\)$"),
        (
            "class Mute(Exception):\n    def __str__(self):\n        raise ValueError\nraise Mute",
            r"Mute \(bad_file.py, line 4\)$",
        ),
        ("def __getattr__(name):\n    raise RuntimeError(name)", "RuntimeError: Mine"),
        ("Mine = 3", "Mine is not a class with a method generate_action"),
    ],
)
def test_files_that_fail_in_odd_ways_give_one_line(tmp_path, monkeypatch, source, message):
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "bad_file.py").write_text(source)
    with pytest.raises(InputError, match=message) as caught:
        find_user_code(f"{tmp_path / 'bad_file.py'}:Mine")
    assert "\n" not in str(caught.value)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(folder, files):
    for name, source in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(source)


def test_the_files_of_a_controller_are_found_without_executing_them(folder):
    stop = "stop()\n"  # fails if it is executed
    write(folder, {"own.py": stop, "package/__init__.py": stop, "package/own.py": stop})
    (folder / "plain").mkdir()
    write(folder, {"plain/own.py": stop})
    for name, file in {
        "own:Mine": "own.py",
        "own.py:Mine": "own.py",
        "package:Mine": "package/__init__.py",
        "package.own:Mine": "package/own.py",
        "plain.own:Mine": "plain/own.py",
    }.items():
        found = user_code_file(name)
        assert found is not None
        assert found.samefile(folder / file)
    assert user_code_file("sys:Mine") is None


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no_such_module:Mine", "no_such_module:Mine: there is no module no_such_module"),
        ("no_such_file.py:Mine", "no_such_file.py does not exist"),
        ("no.such.package:Mine", "no.such.package:Mine: there is no module no.such.package"),
    ],
)
def test_missing_files_are_one_line(folder, name, message):
    with pytest.raises(InputError, match=message):
        user_code_file(name)


def test_a_misspelled_class_is_suggested(folder):
    write(folder, {"good.py": "class Mine: pass"})
    with pytest.raises(InputError, match=r"there is no Mone in good\.py; did you mean 'Mine'?"):
        find_user_code("good.py:Mone")


def test_finds_all_imported_files_of_the_user(folder):
    """In a process of its own, as hours are flown. Libraries are left out."""
    mine = "class Mine:\n    def generate_action(self, *given): pass\n"
    files = {
        "own.py": "import json, numpy, part\nfrom deeper.most import x\n" + mine,
        "part.py": "import os\nos.chdir('/')",
        "deeper/most.py": "from . import other\nx = 1",
        "deeper/other.py": "",
        "unused.py": "",
    }
    write(folder, files)
    command = (
        "import sys; from skystack.agents.user_modules import find_user_code, imported_files\n"
        "find_user_code(sys.argv[1])\n"
        "print(*(f'{path} {digest}' for path, digest in imported_files().items()), sep='\\n')"
    )
    expected = {
        f"{folder / file} {sha256(files[file].encode()).hexdigest()}"
        for file in ("own.py", "part.py", "deeper/most.py", "deeper/other.py")
    }
    for name in ("own:Mine", "own.py:Mine"):
        run = [sys.executable, "-c", command, name]
        found = subprocess.run(run, capture_output=True, text=True, check=True).stdout
        assert set(found.split("\n")[:-1]) == expected
