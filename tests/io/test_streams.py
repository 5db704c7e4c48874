"""Every verb on every kind of standard output, with hostile names in all that it prints."""

import io
import json
import os
import shutil
import sys
from functools import partial
from pathlib import Path

import pytest

from skystack.benchmarking import run as benchmarking
from skystack.benchmarking.figures import Figure
from skystack.cli import main, output
from skystack.evaluation import simulate
from skystack.evaluation.evaluate import Evaluation
from skystack.evaluation.stored import pa
from skystack.io.streams import StandardError, StandardOutput, escaping
from skystack.learning.run import Trained
from skystack.reporting import comparison, report, trainings
from skystack.reporting.replay import page
from skystack.reporting.tables import Table
from skystack.reproduction import run as reproduction
from tests.reporting.test_tables import row

HOSTILE = "[/b][red]\x1b[31m\x9b\u202ex\u2066[link=http://x]:smile:\n\r\x00é"
"""Markup, an emoji, an escape sequence, both kinds of control characters, text turned round."""
ROW = {"experiment": "lateral", "platform": "skystack", "stacking": True, "seeds": 1, "episodes": 2}
ROW |= {name: 0.5 for name in row().__struct_fields__ if name.endswith(("_mean", "_std", "_rate"))}
ROW |= {"loss_of_separation_count": 0}
RESULTS = {"rows": [ROW], "rows_by_seed": [ROW], "comparisons": [], "train": [], "wall_s": 1.0}
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


def always(value):
    return lambda *_, **__: value


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Where verbs find what they read."""
    folder = tmp_path_factory.mktemp("files")
    shutil.copy(VALLEY.with_suffix(".geojson"), folder)
    (folder / "sector.json").write_text(VALLEY.read_text().replace("GATEN", "[/b][red]é"))
    (folder / "results.json").write_text(json.dumps(RESULTS))
    return folder


@pytest.fixture
def quick(monkeypatch, tmp_path):
    """What takes time is done already, and came to hostile names."""
    judged = Evaluation({**ROW, "seed": 0}, pa.table({}), pa.table({}), {3: HOSTILE}, (HOSTILE,))
    trained = Trained(None, 1, 1.0)
    monkeypatch.setattr(Trained, "summary", {"experiment": HOSTILE})
    monkeypatch.setattr("skystack.evaluation.evaluate.evaluate", always(judged))
    monkeypatch.setattr("skystack.evaluation.summary.aggregate", always(ROW))
    monkeypatch.setattr("skystack.learning.run.train_experiment", always(trained))
    monkeypatch.setattr("skystack.learning.run.preflight", always([HOSTILE]))
    monkeypatch.setattr("skystack.compilation.programs.compile_for_one_core", always(None))
    monkeypatch.setattr(reproduction, "run_plan", always({**RESULTS, "kept": [HOSTILE]}))
    monkeypatch.setattr(report, "write_report", always(Path(HOSTILE)))
    monkeypatch.setattr(trainings, "is_reproduction", lambda path: path.name != "compared")
    monkeypatch.setattr(trainings, "read_runs", always([]))
    monkeypatch.setattr(comparison, "write_comparison", always(None))
    monkeypatch.setattr(comparison, "comparison_json", always({"rows": [ROW]}))
    hostile = Table((HOSTILE, HOSTILE), ((HOSTILE, HOSTILE),))
    monkeypatch.setattr(comparison, "comparison_tables", always([hostile]))
    monkeypatch.setattr(
        page, "write_replay", always({"scenarios": 1, "bytes": 1, "runs": [HOSTILE]})
    )
    monkeypatch.setattr(simulate, "simulate_file", always(SUMMARY))
    figure = Figure(HOSTILE, HOSTILE, (1.0,), HOSTILE)
    monkeypatch.setattr(benchmarking, "measure_ourselves", always([figure]))
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
"""And whether they print more than help on standard output without `--json`."""
COMMANDS = [verb for verb, prints in VERBS.items() if prints or verb == "--help"]
COMMANDS += [f"{verb} --json" for verb in VERBS if verb != "--help"]
CODES = {"evaluate lateral": 1, "evaluate lateral --json": 1}  # a scenario that failed


def command(verb, files):
    name = HOSTILE.replace("/", "").replace("\x00", "")
    return [word.format(files=files, HOSTILE=name) for word in verb.split(" ")]


def run(verb, files):
    """The exit code; `--help` ends as argparse does."""
    try:
        return main(command(verb, files))
    except SystemExit as ended:
        return ended.code


@pytest.mark.parametrize("verb", VERBS)
def test_names_from_files_are_escaped(capsys, files, quick, verb):
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
def test_what_an_encoding_lacks_is_escaped(monkeypatch, files, quick, verb, encoding):
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
    assert stream.errors == "strict"  # as it was


@pytest.mark.parametrize("verb", COMMANDS)
def test_a_full_device_and_a_closed_output_are_failures(monkeypatch, capsys, files, quick, verb):
    with Path("/dev/full").open("w") as full:
        for stream, reason in ((full, "No space left on device"), (None, "Bad file descriptor")):
            monkeypatch.setattr(sys, "stdout", stream)
            assert run(verb, files) == 2
            last = capsys.readouterr().err.splitlines()[-1]
            assert last == f"skystack: standard output cannot be written to: {reason}"


@pytest.mark.parametrize("verb", COMMANDS)
def test_a_closed_pipe_ends_quietly(monkeypatch, capsys, files, quick, verb):
    read, write = os.pipe()
    os.close(read)
    with open(write, "w") as closed:  # noqa: PTH123  (of a descriptor)
        monkeypatch.setattr(sys, "stdout", closed)
        assert run(verb, files) == output.PIPE_CLOSED == 128 + 13
    assert "pipe" not in capsys.readouterr().err.lower()


@pytest.mark.parametrize("verb", VERBS)
def test_standard_error_may_be_full_or_closed(monkeypatch, files, quick, verb):
    with Path("/dev/full").open("w", buffering=1) as full:
        for stream in (full, None):
            monkeypatch.setattr(sys, "stderr", stream)
            assert run(verb, files) == CODES.get(verb, 0)
        os.dup2(os.open(os.devnull, os.O_WRONLY), full.fileno())  # what it holds goes there


def test_streams_of_other_kinds_are_left_alone(monkeypatch):
    written = io.StringIO()
    monkeypatch.setattr(sys, "stdout", written)
    monkeypatch.setattr(sys, "stderr", None)
    with escaping():
        StandardOutput().write("a")
        StandardError().write("b")
        StandardError().flush()
    assert written.getvalue() == "a"
    assert partial(getattr, StandardOutput())("getvalue")() == "a"
