"""A signal ends a command whenever it arrives; the process sends it to itself at bad moments."""

import gc
import os
import signal
import subprocess
import sys
import textwrap

import pytest

from skystack.cli import main, verbs
from skystack.io import signals
from skystack.io.signals import defer_signals, exit_code, handle_signals

CODES = {signal.SIGINT: 130, signal.SIGTERM: 143}


@pytest.fixture(autouse=True)
def as_in_a_terminal():
    """Restore Python's handler of SIGINT, which is ignored in background processes of scripts."""
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

MOMENTS = {
    "while it runs": "send()",
    "while a C++ module is imported": """
        import importlib.abc, importlib.machinery, sys
        # As during the import of jaxlib, where an exception aborts the process.
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
    "in a garbage-collection callback": """
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
    "where the exception is discarded": """
        try:
            send()
            spin()
        except BaseException:
            pass
        signals.check()
    """,
    "where the exception is replaced": """
        try:
            send()
        except BaseException as error:
            raise RuntimeError("INTERNAL: in C++") from error
    """,
    "in another thread while the main thread waits": """
        import threading
        from concurrent.futures import Future
        def other():  # the signal is delivered to this thread
            signal.pthread_kill(threading.get_ident(), signal.{name})
            threading.Event().wait()
        threading.Thread(target=other, daemon=True).start()
        signals.wait_for(Future())
    """,
    "in a held block": """
        with signals.defer_signals():
            send()
            print("completed")
        spin()
    """,
    "at interpreter exit": """
        import atexit
        atexit.register(send)
    """,
}


@pytest.mark.parametrize("number", CODES)
@pytest.mark.parametrize("moment", MOMENTS)
def test_signal_ends_a_command(moment, number):
    body = textwrap.dedent(MOMENTS[moment]).replace("{name}", number.name)
    body = textwrap.indent(body, "    ")
    program = COMMAND.format(name=number.name, body=body)
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    if moment == "at interpreter exit":  # the system ends the process; shells report the same code
        assert (done.returncode, done.stderr) == (-number, "")
    else:
        assert (done.returncode, done.stderr) == (CODES[number], "skystack: interrupted\n")
    assert done.stdout == ("completed\n" if moment == "in a held block" else "")


def test_ignored_signal_stays_ignored(monkeypatch):
    """As in a background process of a script."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with handle_signals():
            os.kill(os.getpid(), signal.SIGINT)
        assert exit_code() is None
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_restores_the_handlers_after_a_command(monkeypatch):
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(number) for number in numbers], sys.unraisablehook
    monkeypatch.setattr(verbs, "list_all", lambda options: os.kill(os.getpid(), signal.SIGTERM))
    assert main(["list"]) == 143
    assert ([signal.getsignal(number) for number in numbers], sys.unraisablehook) == before
    gc.collect()
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0


def test_only_a_late_second_signal_kills_the_process(monkeypatch):
    now, killed = [0.0], []
    monkeypatch.setattr(signals.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(signals.os, "kill", lambda *arguments: killed.append(arguments))
    with handle_signals():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        assert (killed, exit_code()) == ([], 130)
        now[0] = signals.DUPLICATE_WINDOW_S + 0.1
        signal.raise_signal(signal.SIGTERM)
        assert killed == [(os.getpid(), signal.SIGTERM)]
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_held_blocks_finish_before_the_interruption():
    done = []
    with handle_signals(), pytest.raises(KeyboardInterrupt):
        send_while_held(done)
    assert done == ["completed"]


def test_signal_inside_jax_is_raised_at_the_next_boundary(monkeypatch):
    """Even without a retry, and after a held block, it is not lost."""
    monkeypatch.setattr(signals, "_is_delicate", lambda frame: True)
    monkeypatch.setattr(signals, "_schedule_retry", lambda after_s: None)
    with handle_signals():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt), defer_signals():
            pass
        with defer_signals():  # clean-up is not interrupted
            pass
        with pytest.raises(KeyboardInterrupt):
            signals.check()
    assert exit_code() == 130


def test_jax_and_imports_are_delicate_but_our_code_is_not():
    jax = pytest.importorskip("jax")
    seen = []

    def record(*_):
        seen.append(signals._is_delicate(sys._getframe()))

    record()
    for file in (jax.__file__, signals.__file__, "<frozen importlib._bootstrap>", "user.py"):
        exec(compile("record()", file, "exec"), {"record": record})
    assert seen == [False, True, False, True, False]


def send_while_held(done):
    with defer_signals(), defer_signals():
        signal.raise_signal(signal.SIGTERM)
        done.append("completed")
