"""The classes of users' controllers, and their files."""

import importlib
import sys

import numpy as np
import pytest

from skystack.agents.user_modules import find_user_code, is_user_code, user_code_files
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


@pytest.mark.parametrize("name", ["counting:Mine", "counting.py:Mine"])
def test_every_hour_imports_all_modules_of_the_user_anew(folder, name):
    """What a class, its module or their neighbours have stored is gone."""
    counting = (
        "import numpy, stored\nhours = []\nclass Mine:\n    hours = []\n"
        "    def generate_action(self, *given):\n"
        "        for each in (hours, self.hours, stored.hours):\n            each.append(1)\n"
        "        return len(hours), len(self.hours), len(stored.hours), id(numpy)\n"
    )
    write(folder, {"counting.py": counting, "stored.py": "hours = []"})
    found = [find_user_code(name)().generate_action() for _ in range(2)]
    assert found == [(1, 1, 1, id(np))] * 2


def test_the_files_of_a_controller_are_found_without_executing_them(folder):
    stop = "stop()\n"  # fails if it is executed
    mine = "class Mine: pass\n"
    files = {
        "alone.py": stop + mine,
        "several.py": stop + "import numpy, part, json\nfrom deeper.most import x\n" + mine,
        "part.py": stop + "import part, several",
        "deeper/__init__.py": stop,
        "deeper/most.py": stop + "from .other import y",
        "deeper/other.py": stop,
        "deeper/own.py": stop + "from deeper import other\n" + mine,
        "unused.py": stop,
        "json.py": stop,
    }
    write(folder, files)
    more = ["deeper/__init__.py", "deeper/most.py", "deeper/other.py", "json.py", "part.py"]
    expected = {
        "alone:Mine": ["alone.py"],
        "alone.py:Mine": ["alone.py"],
        "several:Mine": ["several.py", *more],
        f"{folder}/several.py:Mine": ["several.py", *more],
        "deeper.own:Mine": ["deeper/own.py", "deeper/__init__.py", "deeper/other.py"],
    }
    for name, files in expected.items():
        found = [str(each.resolve().relative_to(folder)) for each in user_code_files(name)]
        assert found == files
    assert user_code_files("sys:Mine") == []


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no_such_module:Mine", "no_such_module:Mine: there is no module no_such_module"),
        ("no_such_file.py:Mine", "no_such_file.py does not exist"),
        ("no.such.package:Mine", "no.such.package:Mine: there is no module no.such.package"),
        ("good:Mone", "there is no Mone in good; did you mean 'Mine'?"),
        ("good.py:mine", r"there is no mine in good\.py; did you mean 'Mine'?"),
        ("wrong:Mine", r"SyntaxError: .* \(wrong\.py, line 2\)"),
        ("latin.py:Mine", "UnicodeDecodeError"),
    ],
)
def test_mistakes_are_found_without_executing_the_file(folder, name, message):
    write(folder, {"good.py": "raise SystemExit(0)\nclass Mine: pass", "wrong.py": "x = 1\nx x"})
    (folder / "latin.py").write_bytes(b"# \xe9\nclass Mine: pass")
    with pytest.raises(InputError, match=message) as caught:
        user_code_files(name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "source",
    ["Mine = 3", "from x import Mine", "import y as Mine", "from x import *", "if 1:\n  Mine = 2",
     "def __getattr__(name): pass", "def Mine(): pass", "for Mine in []: pass"],
)  # fmt: skip
def test_a_class_that_may_be_defined_is_accepted(folder, source):
    write(folder, {"own.py": source})
    assert user_code_files("own:Mine") == [folder / "own.py"]
