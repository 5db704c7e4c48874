"""The machine and the software that figures are measured with."""

import platform
import time

import msgspec

from skystack.compilation.cores import cores, processor_lines
from skystack.learning.policy import package_versions


class Machine(msgspec.Struct):
    """The machine and the software that figures were measured with."""

    system: str
    processor: str
    cores: int
    python: str
    packages: dict[str, str]
    date: str


def this_machine() -> Machine:
    """The machine and the software of this process, today."""
    return Machine(
        system=platform.platform(terse=True),
        processor=_processor(),
        cores=len(cores()),
        python=platform.python_version(),
        packages=package_versions(),
        date=time.strftime("%Y-%m-%d"),
    )


def _processor() -> str:
    named = [line.partition(":")[2].strip() for line in processor_lines("model name")]
    return named[0] if named else platform.processor() or platform.machine()
