"""On a terminal: neither rich nor the terminal interprets anything in a text."""

import io
import re
import sys

from rich.table import Table

from skystack.cli import console
from skystack.cli.console import count_scenarios, output, prose, show_progress
from skystack.learning.run import TrainingProgress

HOSTILE = "[/b][red]\x1b[31m\x9b\u202e[link=http://x]:smile:\r"
ESCAPED = "[/b][red]\\x1b[31m\\x9b\\u202e[link=http://x]:smile:\\r"
OURS = re.compile(r"\x1b\[[\d;?]*[A-Za-z]")
"""What rich writes itself: colours, the cursor."""


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


def terminal(monkeypatch):
    """Both streams, wide enough for one line. (In a fixture pytest would replace them again.)"""
    both = Terminal()
    for name, value in (("COLUMNS", "200"), ("TERM", "xterm"), ("LINES", "50")):
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr(sys, "stdout", both)
    monkeypatch.setattr(sys, "stderr", both)
    return both


def plain(both):
    text = OURS.sub("", both.getvalue()).replace("\r", "").replace("\n", "")
    assert text.isprintable()
    return text


def test_tables_titles_captions_and_texts(monkeypatch):
    both = terminal(monkeypatch)
    table = Table(HOSTILE, title=HOSTILE, caption=HOSTILE)
    table.add_row(HOSTILE)
    output().print(table)
    prose().print(HOSTILE)
    assert plain(both).count(ESCAPED) == 5


def test_progress_of_trainings(monkeypatch):
    both = terminal(monkeypatch)
    with show_progress() as report:
        report(HOSTILE, TrainingProgress(1, 2, 3.0, {"success": 0.5, "return": 1.0}))
    assert ESCAPED in plain(both)


def test_progress_of_scenarios(monkeypatch):
    both = terminal(monkeypatch)
    monkeypatch.setattr(console, "VISIBLE_AFTER_S", 0.0)
    with count_scenarios(HOSTILE, 2) as count:
        count(1)
    assert ESCAPED in plain(both)
