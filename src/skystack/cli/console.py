"""Tables on standard output and progress on standard error.

Names may come from files: texts are never interpreted as markup, and unprintable characters are
escaped.
"""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.text import Text

from skystack.errors import printable
from skystack.io.streams import StandardError, StandardOutput
from skystack.learning.run import TrainingProgress

PLAIN_EVERY_S = 10.0
"""The interval of progress lines, printed instead of a bar when there is no terminal."""
VISIBLE_AFTER_S = 2.0
"""Work that takes less time shows no progress."""


class PlainConsole(Console):
    """Prints every text literally, also in tables and titles."""

    def render_str(self, text: str, **options: Any) -> Text:
        plain = {"markup": False, "emoji": False, "highlight": False}
        return super().render_str(printable(text), **(options | plain))

    def on_broken_pipe(self) -> None:
        """Raise the error to the caller; rich would exit the process."""
        raise BrokenPipeError


def output() -> Console:
    """The console for results; without a terminal it is wide enough for the tables."""
    file: Any = StandardOutput()
    console = PlainConsole(file=file)
    return console if console.is_terminal else PlainConsole(file=file, width=160)


def prose() -> Console:
    """The console for progress and messages."""
    file: Any = StandardError()
    return PlainConsole(file=file)


class _Description(ProgressColumn):
    """The label of a progress bar."""

    def render(self, task: Task) -> Text:
        return Text(printable(task.description))


@contextmanager
def show_progress() -> Iterator[Callable[[str, TrainingProgress], None]]:
    """Show the progress of named trainings: steps, speed, time left, return and success."""
    console = prose()
    if not console.is_terminal:
        yield _PlainProgress(console).report
        return
    columns = (
        _Description(),
        BarColumn(bar_width=12),
        TextColumn("{task.completed:,.0f}/{task.total:,.0f}"),
        TextColumn("{task.fields[speed]}"),
        TextColumn("{task.fields[score]}"),
    )
    with Progress(*columns, console=console) as bars:
        tasks: dict[str, TaskID] = {}

        def report(name: str, step: TrainingProgress) -> None:
            if name not in tasks:
                tasks[name] = bars.add_task(name, total=step.total_steps, speed="", score="")
            bars.update(tasks[name], completed=step.steps, speed=_speed(step), score=_score(step))

        yield report


@contextmanager
def count_scenarios(name: str, total: int) -> Iterator[Callable[[int], None]]:
    """Show the number of finished scenarios, the speed and the time left, if it takes long."""
    started = time.monotonic()
    last_shown = started

    def line(done: int) -> str:
        rate = done / max(time.monotonic() - started, 1e-9)
        return f"{done}/{total} scenarios {rate:.2f}/s, {(total - done) / rate:.0f} s left"

    console = prose()
    if console.is_terminal:
        with Progress(_Description(), BarColumn(), console=console) as bars:
            task = bars.add_task(name, total=total, visible=False)
            yield lambda done: bars.update(
                task,
                completed=done,
                description=f"{name} {line(done)}",
                visible=time.monotonic() - started >= VISIBLE_AFTER_S,
            )
        return

    def report(done: int) -> None:
        nonlocal last_shown
        if time.monotonic() - last_shown >= PLAIN_EVERY_S:
            last_shown = time.monotonic()
            _print_plain(console, f"{name} {line(done)}")

    yield report


class _PlainProgress:
    """Prints the progress of trainings as lines for a log file."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._shown: dict[str, float] = {}

    def report(self, name: str, step: TrainingProgress) -> None:
        now = time.monotonic()
        due = now - self._shown.get(name, -PLAIN_EVERY_S) >= PLAIN_EVERY_S
        if due or step.steps >= step.total_steps:
            self._shown[name] = now
            done = f"{step.steps:,}/{step.total_steps:,} steps"
            _print_plain(self._console, f"{name} {done} {_speed(step)} {_score(step)}")


def _print_plain(console: Console, line: str) -> None:
    console.print(line, soft_wrap=True)


def _speed(step: TrainingProgress) -> str:
    if math.isnan(step.steps_per_s):
        return "compiled"
    left = (step.total_steps - step.steps) / step.steps_per_s
    return f"{step.steps_per_s:,.0f} steps/s, {left:.0f} s left"


def _score(step: TrainingProgress) -> str:
    success, mean_return = step.measured.get("success"), step.measured.get("return")
    if success is None or mean_return is None:
        return ""
    return f"success {success:.2f} return {mean_return:.1f}"
