"""Every verb with every kind of standard output, and with hostile names in all printed values."""

import io
import json
import os
import shutil
import sys
from functools import partial
from pathlib import Path

import msgspec
import pytest

from skystack.benchmarking import run as benchmarking
from skystack.benchmarking.figures import Figure
from skystack.cli import main, output
from skystack.evaluation import simulate
from skystack.evaluation.evaluate import Evaluation
from skystack.evaluation.stored import pa
from skystack.io.streams import StandardError, StandardOutput, escaping
from skystack.learning.run import Trained
from skystack.reporting import comparison, report, results, trainings
from skystack.reporting.replay import page
from skystack.reporting.results import Results, Run
from skystack.reporting.table import Table
from skystack.reproduction import run as reproduction
from tests.reporting.rows import row

HOSTILE = "[/b][red]\x1b[31m\x9b\u202ex\u2066[link=http://x]:smile:\n\r\x00é"
"""Markup, an emoji, an escape sequence, both kinds of control characters, and reversed text."""
ROW = {"experiment": "lateral", "platform": "skystack", "stacking": True, "seeds": 1, "episodes": 2}
ROW |= {name: 0.5 for name in row().__struct_fields__ if name.endswith(("_mean", "_std", "_rate"))}
ROW |= {"loss_of_separation_count": 0}
RESULTS = {
    "machine": HOSTILE,
    "version": "",
    "command": "",
    "quick": False,
    "rows": [ROW],
    "rows_by_seed": [ROW],
    "comparisons": [],
    "train": [],
    "wall_s": 1.0,
}
FINAL = dict.fromkeys(("lat", "lon", "fl", "heading_deg", "ground_speed_kt", "time_s"), 1.0)
SUMMARY = {
    "scenario": HOSTILE,
    "rows": 1,
    "notes": [HOSTILE],
    "clearances": [{"cycle": 1, "callsign": HOSTILE, "text": HOSTILE}],
    "losses_of_separation": 0,
    "min_separation_nm": None,
    "final": [FINAL | {"callsign": HOSTILE, "status": "exited"}],
}
VALLEY = Path(__file__).parents[2] / "examples" / "own-sector" / "valley.json"


def returning(value):
    return lambda *_, **__: value


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the input files of the verbs."""
    folder = tmp_path_factory.mktemp("files")
    shutil.copy(VALLEY.with_suffix(".geojson"), folder)
    (folder / "sector.json").write_text(VALLEY.read_text().replace("GATEN", "[/b][red]é"))
    (folder / "results.json").write_text(json.dumps(RESULTS))
    return folder


@pytest.fixture
def slow_functions_replaced(monkeypatch, tmp_path):
    """Replace slow functions by constant results with hostile names."""
    evaluated = Evaluation({**ROW, "seed": 0}, pa.table({}), pa.table({}), {3: HOSTILE}, (HOSTILE,))
    trained = Trained(None, 1, 1.0)
    monkeypatch.setattr(Trained, "summary", {"experiment": HOSTILE})
    monkeypatch.setattr("skystack.evaluation.evaluate.evaluate", returning(evaluated))
    monkeypatch.setattr("skystack.evaluation.summary.aggregate", returning(ROW))
    monkeypatch.setattr("skystack.learning.run.train_experiment", returning(trained))
    monkeypatch.setattr("skystack.learning.run.preflight", returning([HOSTILE]))
    monkeypatch.setattr("skystack.compilation.programs.compile_for_cores", returning(None))
    monkeypatch.setattr(reproduction, "run_plan", returning({**RESULTS, "kept": [HOSTILE]}))
    stored = msgspec.convert(RESULTS, Results)
    monkeypatch.setattr(results, "read_run", returning(Run(tmp_path, stored, None)))
    monkeypatch.setattr(report, "write_report", returning(Path(HOSTILE)))
    monkeypatch.setattr(trainings, "is_reproduction", lambda path: path.name != "compared")
    monkeypatch.setattr(trainings, "read_runs", returning([]))
    monkeypatch.setattr(comparison, "write_comparison", returning(None))
    monkeypatch.setattr(comparison, "comparison_json", returning({"rows": [ROW]}))
    hostile = Table((HOSTILE, HOSTILE), ((HOSTILE, HOSTILE),))
    monkeypatch.setattr(comparison, "comparison_tables", returning([hostile]))
    monkeypatch.setattr(
        page, "write_replay", returning({"scenarios": 1, "bytes": 1, "runs": [HOSTILE]})
    )
    monkeypatch.setattr(simulate, "simulate_file", returning(SUMMARY))
    figure = Figure(HOSTILE, HOSTILE, (1.0,), HOSTILE)
    monkeypatch.setattr(benchmarking, "measure_skystack", returning([figure]))
    monkeypatch.setenv("SKYSTACK_CACHE", "off")
    monkeypatch.chdir(tmp_path)


VERBS = {
    "--help": False,
    "list": True,
    "sector {files}/sector.json": True,
    "simulate x.json": True,
    "evaluate lateral": True,
    "train lateral": False,
    "reproduce": True,
    "report {files}": True,
    "report compared": True,
    "replay x -o {HOSTILE}.html": False,
    "export lateral --format numpy -o {HOSTILE}": False,
    "bench": True,
}
"""Commands, and whether they print results to standard output without `--json`."""
COMMANDS = [verb for verb, prints in VERBS.items() if prints or verb == "--help"]
COMMANDS += [f"{verb} --json" for verb in VERBS if verb != "--help"]
CODES = {"evaluate lateral": 1, "evaluate lateral --json": 1}  # because of a failed scenario


def words(verb, files):
    name = HOSTILE.replace("/", "").replace("\x00", "")
    return [word.format(files=files, HOSTILE=name) for word in verb.split(" ")]


def run(verb, files):
    """The exit code; with `--help`, argparse raises SystemExit."""
    try:
        return main(words(verb, files))
    except SystemExit as error:
        return error.code


@pytest.mark.parametrize("verb", VERBS)
def test_escapes_names_from_files(capsys, files, slow_functions_replaced, verb):
    code = run(verb, files)
    out, err = capsys.readouterr()
    assert code == CODES.get(verb, 0), err
    for text in (out, err):
        assert text.replace("\n", "").isprintable()
    if verb not in ("--help", "list", "sector {files}/sector.json"):
        assert "\\x9b\\u202ex\\u2066[" in "".join((out + err).split())
    if "sector" in verb:
        assert "[/b][red]é" in out


@pytest.mark.parametrize("verb", COMMANDS)
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_escapes_characters_that_the_encoding_lacks(
    monkeypatch, files, slow_functions_replaced, verb, encoding
):
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding=encoding, errors="strict")
    monkeypatch.setattr(sys, "stdout", stream)
    code = run(verb, files)
    stream.flush()
    assert code == CODES.get(verb, 0)
    text = raw.getvalue().decode(encoding)
    assert text.replace("\n", "").isprintable()
    if verb.endswith("--json"):
        json.loads(text)
    assert stream.errors == "strict"  # restored


@pytest.mark.parametrize("verb", COMMANDS)
def test_full_or_closed_standard_output_is_an_error(
    monkeypatch, capsys, files, slow_functions_replaced, verb
):
    with Path("/dev/full").open("w") as full:
        for stream, reason in ((full, "No space left on device"), (None, "Bad file descriptor")):
            monkeypatch.setattr(sys, "stdout", stream)
            assert run(verb, files) == 2
            last = capsys.readouterr().err.splitlines()[-1]
            assert last == f"skystack: standard output cannot be written to: {reason}"


@pytest.mark.parametrize("verb", COMMANDS)
def test_closed_pipe_ends_quietly(monkeypatch, capsys, files, slow_functions_replaced, verb):
    read, write = os.pipe()
    os.close(read)
    with open(write, "w") as closed:  # noqa: PTH123  (opens a descriptor)
        monkeypatch.setattr(sys, "stdout", closed)
        assert run(verb, files) == output.PIPE_CLOSED == 128 + 13
    assert "broken" not in capsys.readouterr().err.lower()


@pytest.mark.parametrize("verb", VERBS)
def test_standard_error_may_be_full_or_closed(monkeypatch, files, slow_functions_replaced, verb):
    with Path("/dev/full").open("w", buffering=1) as full:
        for stream in (full, None):
            monkeypatch.setattr(sys, "stderr", stream)
            assert run(verb, files) == CODES.get(verb, 0)
        os.dup2(os.open(os.devnull, os.O_WRONLY), full.fileno())  # flushes its buffer there


def test_other_streams_are_not_modified(monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(sys, "stderr", None)
    with escaping():
        StandardOutput().write("a")
        StandardError().write("b")
        StandardError().flush()
    assert stream.getvalue() == "a"
    assert partial(getattr, StandardOutput())("getvalue")() == "a"
