"""Neither rich nor the terminal interprets markup or control characters in texts."""

import io
import re
import sys

from rich.table import Table

from skystack.cli.console import STARTING, count_scenarios, output, prose, show_progress
from skystack.learning.progress import TrainingProgress

HOSTILE = "[/b][red]\x1b[31m\x9b\u202e[link=http://x]:smile:\r"
ESCAPED = "[/b][red]\\x1b[31m\\x9b\\u202e[link=http://x]:smile:\\r"
RICH_CODES = re.compile(r"\x1b\[[\d;?]*[A-Za-z]")
"""What rich itself writes: colours and cursor movements."""


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


def terminal(monkeypatch, columns=200):
    """Both output streams, wide enough for one line. (Pytest would replace those of a fixture.)"""
    stream = Terminal()
    for name, value in (("COLUMNS", str(columns)), ("TERM", "xterm"), ("LINES", "50")):
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(sys, "stderr", stream)
    return stream


def plain(stream):
    text = RICH_CODES.sub("", stream.getvalue()).replace("\r", "").replace("\n", "")
    assert text.isprintable()
    return text


def test_escapes_tables_titles_captions_and_texts(monkeypatch):
    stream = terminal(monkeypatch)
    table = Table(HOSTILE, title=HOSTILE, caption=HOSTILE)
    table.add_row(HOSTILE)
    output().print(table)
    prose().print(HOSTILE)
    assert plain(stream).count(ESCAPED) == 5


def test_escapes_the_progress_of_trainings(monkeypatch):
    stream = terminal(monkeypatch)
    with show_progress() as report:
        report(HOSTILE, TrainingProgress(1, 2, 3.0, {"success": 0.5, "return": 1.0}))
    assert ESCAPED in plain(stream)


def test_shows_the_phases_of_jobs(monkeypatch):
    stream = terminal(monkeypatch)
    with show_progress(2) as report:
        report("one", TrainingProgress(1_000, 2_000, 3.0, {}))
        report("one", "evaluating")
        report("other", "evaluating")
        report("other", "done")
    shown = plain(stream)
    assert "1,000/2,000" in shown
    assert "evaluating" in shown
    assert "all jobs" in shown


def test_names_and_figures_of_jobs_fit_80_columns(monkeypatch):
    stream = terminal(monkeypatch, columns=80)
    names = ("lateral-best-s0", "avoidance-large-s10")
    with show_progress(2) as report:
        assert STARTING in plain(stream)
        for name in names:
            measured = {"success": 0.95, "return": -12.3}
            report(name, TrainingProgress(1_015_808, 60_000_000, 131_072.0, measured))
    shown = RICH_CODES.sub("", stream.getvalue()).replace("\r", "\n").splitlines()
    assert max(map(len, shown)) <= 80
    for name in names:
        line = next(line for line in reversed(shown) if name in line)
        assert re.search(r"2 % 131,072 steps/s, 450 s left success 0\.95", line)
    assert STARTING not in shown[-1]


def test_phases_of_jobs_are_lines_without_a_terminal(capsys):
    with show_progress(2) as report:
        report("one", "evaluating")
        report("one", "done")
    assert capsys.readouterr().err == "one evaluating\none done (1 of 2 jobs)\n"


def test_escapes_the_progress_of_scenarios(monkeypatch):
    stream = terminal(monkeypatch)
    with count_scenarios(HOSTILE, 2) as count:
        count(1)
    assert ESCAPED in plain(stream)
