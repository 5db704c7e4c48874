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
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)
from rich.table import Column
from rich.text import Text

from skystack.errors import printable
from skystack.io.streams import StandardError, StandardOutput
from skystack.learning.progress import TrainingProgress

PLAIN_EVERY_S = 10.0
"""The interval of progress lines, printed instead of a bar when there is no terminal."""
DONE = "done"
"""The last phase of a job."""


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


NARROW = 110
"""In narrower terminals, progress is shown as a percentage and without the return."""
STARTING = "starting processes and compiling ..."


class _Description(ProgressColumn):
    """The label of a progress bar. It is never shortened to make room for other columns."""

    def __init__(self) -> None:
        super().__init__(Column(no_wrap=True))

    def render(self, task: Task) -> Text:
        return Text(printable(task.description))


@contextmanager
def show_progress(jobs: int = 1) -> Iterator[Callable[[str, TrainingProgress | str], None]]:
    """Show the progress of named jobs: steps, speed, time left, return and success while they
    train, otherwise their phase; with several jobs also how many are done."""
    console = prose()
    if not console.is_terminal:
        yield _PlainProgress(console, jobs).report
        return
    narrow = console.width < NARROW
    columns = (
        _Description(),
        BarColumn(bar_width=4 if narrow else 12),
        TextColumn("{task.fields[steps]}"),
        TextColumn("{task.fields[speed]}"),
        TextColumn("{task.fields[score]}"),
    )
    with Progress(*columns, console=console) as bars:
        tasks: dict[str, TaskID] = {}
        blank: dict[str, Any] = {"steps": "", "speed": "", "score": ""}
        starting = blank | {"speed": STARTING}
        whole = bars.add_task("all jobs", total=jobs, visible=jobs > 1, **starting)

        def report(name: str, step: TrainingProgress | str) -> None:
            if name not in tasks:
                bars.update(whole, speed="")
                tasks[name] = bars.add_task(name, total=None, **blank)
            if isinstance(step, str):
                bars.update(tasks[name], speed=step)
                if step == DONE:
                    bars.update(tasks[name], total=1, completed=1, visible=False)
                    bars.advance(whole)
                return
            bars.update(
                tasks[name],
                total=step.total_steps,
                completed=step.steps,
                steps=_steps(step, narrow),
                speed=_speed(step),
                score=_score(step, narrow),
            )

        yield report


@contextmanager
def count_scenarios(
    name: str, total: int, noun: str = "scenarios"
) -> Iterator[Callable[[int], None]]:
    """Show that scenarios are flown, and if it takes long how many, the speed and the time left."""
    next_due = time.monotonic()
    first: tuple[int, float] | None = None
    """The first report: what is compiled before it does not count as time per scenario."""

    def line(done: int) -> str:
        nonlocal first
        if not done:
            return f"{name}: compiling, then flying {total:,} {noun} ..."
        now = time.monotonic()
        if first is None or done <= first[0]:
            first = (done, now)
            return f"{name}: {done:,}/{total:,} {noun}"
        rate = (done - first[0]) / max(now - first[1], 1e-9)
        left_s = (total - done) / rate
        return f"{name}: {done:,}/{total:,} {noun} {rate:.2f}/s, {left_s:.0f} s left"

    console = prose()
    if console.is_terminal:
        columns = (SpinnerColumn(), _Description(), BarColumn(bar_width=12), TimeElapsedColumn())
        with Progress(*columns, console=console, transient=True) as bars:
            task = bars.add_task(name, total=total, visible=False)
            yield lambda done: bars.update(
                task, completed=done, description=line(done), visible=done < total
            )
        return

    def report(done: int) -> None:
        nonlocal next_due
        if time.monotonic() >= next_due:
            next_due = time.monotonic() + PLAIN_EVERY_S
            _print_plain(console, line(done))

    yield report


class _PlainProgress:
    """Prints the progress of jobs as lines for a log file."""

    def __init__(self, console: Console, jobs: int) -> None:
        self._console, self._jobs, self._finished = console, jobs, 0
        self._shown: dict[str, float] = {}

    def report(self, name: str, step: TrainingProgress | str) -> None:
        if isinstance(step, str):
            self._finished += step == DONE
            count = f" ({self._finished} of {self._jobs} jobs)" if step == DONE else ""
            _print_plain(self._console, f"{name} {step}{count}")
            return
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
        return "compiled"  # the first update has no speed
    left = (step.total_steps - step.steps) / step.steps_per_s
    return f"{step.steps_per_s:,.0f} steps/s, {left:.0f} s left"


def _steps(step: TrainingProgress, narrow: bool) -> str:
    if narrow:
        return f"{100.0 * step.steps / step.total_steps:.0f} %"
    return f"{step.steps:,}/{step.total_steps:,}"


def _score(step: TrainingProgress, narrow: bool = False) -> str:
    success, mean_return = step.measured.get("success"), step.measured.get("return")
    if success is None or mean_return is None:
        return ""
    return f"success {success:.2f}" + ("" if narrow else f" return {mean_return:.1f}")
