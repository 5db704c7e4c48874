"""Work for worker processes, in a separate module that they can import."""

import os
import subprocess
import sys
import threading
import time

from skystack.errors import InputError


def make():
    """Work that succeeds, fails, hangs or dies, depending on the item."""

    def work(item, report):
        report("cycle 0")
        if item == "wrong":
            raise InputError("AC1 has left")
        if item == "bug":
            raise KeyError(item)
        if item == "hangs":
            time.sleep(600.0)
        if item == "dies":
            os._exit(7)
        if item == "leaves a process":
            return subprocess.Popen(["sleep", "600"]).pid, os.getpid()
        if item == "leaves a thread":
            threading.Thread(target=time.sleep, args=(600.0,)).start()
        sys.stdout.write("printed\n")
        report("cycle 1")
        return item.upper(), os.getpid()

    return work


def make_and_die():
    os._exit(9)
