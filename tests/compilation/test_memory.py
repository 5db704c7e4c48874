import ctypes
import platform
import subprocess
import sys
from types import SimpleNamespace

import pytest

from skystack.compilation.memory import return_freed_memory

FREE_AND_RETURN = """
from pathlib import Path
from skystack.compilation.memory import return_freed_memory

def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

blocks = [bytes(64_000) for _ in range(2_000)]  # small enough to be allocated on the heap
del blocks[:-1]  # the last one keeps the heap from shrinking by itself
before = resident_mb()
return_freed_memory()
print(before - resident_mb())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries differ")
def test_freed_memory_is_returned():
    command = [sys.executable, "-c", FREE_AND_RETURN]
    done = subprocess.run(command, capture_output=True, text=True, check=True)

    assert float(done.stdout) > 50


def test_other_c_libraries_are_left_alone(monkeypatch):
    monkeypatch.setattr(ctypes, "CDLL", lambda name: SimpleNamespace())

    return_freed_memory()
