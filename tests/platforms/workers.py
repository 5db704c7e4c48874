"""Work for other processes; in a module of its own, for processes to import."""

import os
import time

from skystack.errors import InputError, PlatformError


def make(folder):
    """Work that writes into the folder of its process."""
    (folder / "made").touch()

    def work(item):
        if item == "lost":
            raise PlatformError("lost AC1")
        if item == "wrong":
            raise InputError("fl is 3")
        if item == "hangs":
            time.sleep(600.0)
        if item == "dies":
            os._exit(7)
        return item.upper(), folder, os.getpid()

    return work


def make_nothing(folder):
    raise InputError("no such platform")


def make_badly(folder):
    raise ValueError("two\n  lines")


def make_and_die(folder):
    os._exit(9)
