"""The documentation: every block of code runs, and every link resolves."""

import io
import json
import re
import shlex
import shutil
import sys
import tomllib
from pathlib import Path

import pytest

import dev
from skystack.airspace.sector_file import read_sector
from skystack.cli import main
from skystack.cli.arguments import build_parser, parse
from skystack.learning.experiment import load_experiment
from skystack.simulator.scenario_file import load_scenario
from tests.cli.test_hours import SMALL as SECTOR_TRAINING
from tests.docs.blocks import PAGES, ROOT, anchors, blocks


def settings(*changes):
    return [word for change in changes for word in ("--set", change)]


SCENARIOS = ["--episodes", "2"]
HOURS = ["--episodes", "1", "--cycles", "20"]
TRAINING = settings(
    *("ppo.total_steps=512", "ppo.environments=8", "ppo.steps=32"),
    *("ppo.minibatch=64", "ppo.epochs=1"),
)
"""Arguments that make a documented command fast enough for a test; `SECTOR_TRAINING` is also used
by another test, so its programs are compiled once."""
PARSED_ONLY = {"reproduce", "bench", "flight-school"}
"""Verbs that are always too slow: tests/cli runs them, here they are only parsed."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder of a reader, with the examples and nothing else."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    for file in (ROOT / "examples" / "own-sector").iterdir():
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_command(text):
    program, *words = shlex.split(text, comments=True)
    if program == "pip":
        assert words[0] in ("install", "wheel")
        extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
        for group in re.findall(r"\[(.*?)\]", text):
            assert set(group.split(",")) <= set(extras["optional-dependencies"]), text
    elif program.startswith("python"):
        path = ROOT / (Path(*words[1].split(".")) if words[0] == "-m" else words[0])
        files = (path, path.with_suffix(".py"), path / "__main__.py")
        assert any(file.is_file() for file in files), text
        assert words[0] != "dev.py" or words[1] in dev.EXTRAS, text
    elif words[0] in PARSED_ONLY:
        parse(words)
    elif words[0] == "session":
        typed = io.TextIOWrapper(io.BytesIO(b"3\nflights\nquit\n"))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "stdin", typed)
            assert main([*words, "--text"]) == 0, text
    else:
        assert main([*words, *quick(words)]) == 0, text


def quick(words):
    """Further arguments, with which the command does the same on less traffic or in fewer steps."""
    if words[0] == "evaluate":
        return HOURS if "--traffic" in words else SCENARIOS
    if words[0] == "train":
        return SECTOR_TRAINING if words[1] == "sector-control" else TRAINING
    return []


def check_inline_command(text):
    """A command in a sentence may omit arguments; the verb and options that it names exist."""
    _, *words = shlex.split(text)
    if not words[0].startswith("-"):
        parser = build_parser().verbs[words[0]]
        options = {word.split("=")[0] for word in words if word.startswith("--")}
        assert options <= set(parser._option_string_actions), text


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
@pytest.mark.usefixtures("one_process")
def test_every_block_of_code_runs(page, folder, capsys):
    """Blocks run in the order of the page and in one folder, Python blocks in one session."""
    session: dict[str, object] = {}
    for number, block in enumerate(blocks(page)):
        if block.language == "python":
            exec(compile(block.text, f"{page.name} block {number}", "exec"), session)
        elif block.language == "toml":
            name = tomllib.loads(block.text)["name"]
            (folder / f"{name}.toml").write_text(block.text)
            assert load_experiment(f"{name}.toml").name == name
        elif block.language == "json":
            path = folder / "block.json"
            path.write_text(block.text)
            (load_scenario if "aircraft" in json.loads(block.text) else read_sector)(path)
        elif block.language == "command":
            run_command(block.text)
        elif block.language == "inline":
            check_inline_command(block.text)
        elif block.language != "bibtex":
            assert page.name in ("index.md", "api.md")  # Sphinx directives
    capsys.readouterr()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_resolves(page):
    for target in re.findall(r"\]\(([^)]+)\)", page.read_text()):
        if target.startswith("https://"):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_to_a_decision_lead_to_its_section(page):
    links = re.findall(r"\[decision\s+(\d+)\]\((?:docs/)?decisions\.md(\S*)\)", page.read_text())
    assert [link for link in links if not link[1].startswith(f"#{link[0]}-")] == []


def test_documents_every_check_study_and_tool():
    text = "\n".join(page.read_text() for page in PAGES)
    commands = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__main__")
        for folder in ("verification", "studies", "tools")
        for path in (ROOT / folder).rglob("*.py")
        if "__main__" in path.read_text()
    }
    assert {name for name in commands if not re.search(rf"python -m {name}\b", text)} == set()
