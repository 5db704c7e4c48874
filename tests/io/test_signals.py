"""A signal ends a command wherever it arrives; the process sends it to itself at bad moments."""

import gc
import os
import signal
import subprocess
import sys
import textwrap

import pytest

from skystack.cli import main, verbs
from skystack.io import signals
from skystack.io.signals import ended_by_signals, exit_code, held

CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}


@pytest.fixture(autouse=True)
def as_at_a_terminal():
    """A background process of a script ignores SIGINT, and so would tests run in it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


COMMAND = """
import os, signal, sys
from skystack.io import signals
from skystack.__main__ import run
from skystack.cli import verbs

signal.signal(signal.SIGINT, signal.default_int_handler)

def send():
    os.kill(os.getpid(), signal.{name})

def spin():
    while True:
        signal.sigtimedwait([], 0.01)

def list_all(options):
{body}
    return 0

verbs.list_all = list_all
sys.argv = ["skystack", "list"]
run()
"""

PLACES = {
    "while it runs": "send()",
    "in the import of C++": """
        import importlib.abc, importlib.machinery, sys
        # As while jaxlib's own module is made: an exception there ends the process.
        class Loader(importlib.abc.Loader):
            def exec_module(self, module):
                send()
                module.whole = True
        class Finder:
            def find_spec(name, *_):
                if name == "delicate":
                    return importlib.machinery.ModuleSpec(name, Loader())
        sys.meta_path.insert(0, Finder)
        import delicate
        assert delicate.whole
        spin()
    """,
    "in a callback of a garbage collection": """
        import gc
        gc.callbacks.append(lambda *_: gc.callbacks.clear() or send())
        gc.collect()
        spin()
    """,
    "in __del__": """
        class Last:
            def __del__(self):
                send()
        Last()
        spin()
    """,
    "what swallows it": """
        try:
            send()
            spin()
        except BaseException:
            pass
        signals.check()
    """,
    "what makes another error of it": """
        try:
            send()
        except BaseException as error:
            raise RuntimeError("INTERNAL: in C++") from error
    """,
    "in another thread, while the main one waits": """
        import threading
        from concurrent.futures import Future
        def other():  # takes the signal itself
            signal.pthread_kill(threading.get_ident(), signal.{name})
            threading.Event().wait()
        threading.Thread(target=other, daemon=True).start()
        signals.wait_for(Future())
    """,
    "in what must be whole": """
        with signals.held():
            send()
            print("whole")
        spin()
    """,
    "at the very end": """
        import atexit
        atexit.register(send)
    """,
}


@pytest.mark.parametrize("number", CODES)
@pytest.mark.parametrize("place", PLACES)
def test_a_signal_ends_a_command(place, number):
    body = textwrap.dedent(PLACES[place]).replace("{name}", number.name)
    body = textwrap.indent(body, "    ")
    program = COMMAND.format(name=number.name, body=body)
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    if place == "at the very end":  # the system ends it, as shells report with the same number
        assert (done.returncode, done.stderr) == (-number, "")
    else:
        assert (done.returncode, done.stderr) == (CODES[number], "skystack: interrupted\n")
    assert done.stdout == ("whole\n" if place == "in what must be whole" else "")


def test_an_ignored_signal_stays_ignored(monkeypatch):
    """As of a command in the background of a script."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with ended_by_signals():
            os.kill(os.getpid(), signal.SIGINT)
        assert exit_code() is None
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_handlers_are_as_they_were_after_a_command(monkeypatch):
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(number) for number in numbers], sys.unraisablehook
    monkeypatch.setattr(verbs, "list_all", lambda options: os.kill(os.getpid(), signal.SIGTERM))
    assert main(["list"]) == 143
    assert ([signal.getsignal(number) for number in numbers], sys.unraisablehook) == before
    gc.collect()
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0


def test_an_early_second_signal_is_ignored_and_a_later_one_ends_the_process(monkeypatch):
    now, killed = [0.0], []
    monkeypatch.setattr(signals.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(signals.os, "kill", lambda *what: killed.append(what))
    with ended_by_signals():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        assert (killed, exit_code()) == ([], 130)
        now[0] = signals.PATIENCE_S + 0.1
        signal.raise_signal(signal.SIGTERM)
        assert killed == [(os.getpid(), signal.SIGTERM)]
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_held_blocks_finish_before_the_interruption():
    done = []
    with ended_by_signals(), pytest.raises(KeyboardInterrupt):
        send_while_held(done)
    assert done == ["whole"]


def test_a_signal_during_jax_is_raised_at_the_next_boundary(monkeypatch):
    """Held in between, and with no alarm: it must not be forgotten."""
    monkeypatch.setattr(signals, "_is_delicate", lambda frame: True)
    monkeypatch.setattr(signals, "_schedule_retry", lambda after_s: None)
    with ended_by_signals():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt), held():
            pass
        with held():  # cleaning up is not interrupted
            pass
        with pytest.raises(KeyboardInterrupt):
            signals.check()
    assert exit_code() == 130


def test_jax_and_imports_are_delicate_and_our_code_is_not():
    jax = pytest.importorskip("jax")
    seen = []

    def look(*_):
        seen.append(signals._is_delicate(sys._getframe()))

    look()
    for file in (jax.__file__, signals.__file__, "<frozen importlib._bootstrap>", "user.py"):
        exec(compile("look()", file, "exec"), {"look": look})
    assert seen == [False, True, False, True, False]


def send_while_held(done):
    with held(), held():
        signal.raise_signal(signal.SIGTERM)
        done.append("whole")
