"""Work for other processes, in a separate module that they can import."""

import os
import time

from skystack.errors import InputError, PlatformError


def make(folder):
    """Work that succeeds, fails, hangs or dies, depending on the item; it marks its folder."""
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


def make_with_input_error(folder):
    raise InputError("no such platform")


def make_with_value_error(folder):
    raise ValueError("two\n  lines")


def make_and_die(folder):
    os._exit(9)
