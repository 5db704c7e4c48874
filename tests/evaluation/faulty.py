"""A platform that fails on purpose, in its own module so that processes can import it."""

import os
import time
from pathlib import Path

import numpy as np

from skystack.errors import PlatformError
from skystack.platforms.guard import Guarded
from skystack.platforms.own import Skystack
from skystack.platforms.protocol import Platform, Report

DIES, LOSES, BREAKS, NONSENSE, LEAVES = 1, 4, 5, 6, 7
"""The scenarios in which it fails, unless it hangs."""


class Faulty(Skystack):
    """Our simulator, failing in some scenarios, which it recognises by their starting latitudes."""

    def __init__(self, starts: tuple[float, ...], hangs: tuple[int, ...]) -> None:
        super().__init__()
        self._starts, self._hangs = starts, hangs

    def reset(self, scenario):
        self._number = self._starts.index(round(scenario.aircraft[0].lat, 6))
        self._cycle = 0
        return super().reset(scenario)

    def advance(self) -> Report:
        self._cycle += 1
        if self._cycle == 3:
            if self._number in self._hangs:
                time.sleep(1e6)
            if self._number == DIES:
                os._exit(7)
            if self._number == LOSES:
                raise PlatformError("Faulty has lost AC1")
            if self._number == BREAKS:
                raise KeyError("AC1")
            if self._number == LEAVES:
                raise SystemExit(0)
        report = super().advance()
        return report._replace(lat=report.lat * np.nan) if self._number == NONSENSE else report


def open_faulty(starts: tuple[float, ...], hangs: tuple[int, ...], folder: Path) -> Platform:
    return Guarded(lambda: Faulty(starts, hangs))


def open_own(folder: Path) -> Platform:
    return Guarded(Skystack)


def open_nothing(folder: Path) -> Platform:
    raise PlatformError("it does not start")


def open_badly(folder: Path) -> Platform:
    raise ImportError("no such\nlibrary")


def open_and_die(folder: Path) -> Platform:
    os._exit(9)
