"""Start, step and stop BlueSky: detached, in simulation mode, silent, in steps of one second.

BlueSky keeps its state in its modules, so only one may be open in a process at a time. It writes
only into the folder that it is opened with.

Needs `bluesky-simulator` (extra `[bluesky]`).
"""

import io
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from zipfile import ZipFile

import numpy as np
from jaxtyping import Float

from skystack.errors import PlatformError, requires_extra
from skystack.platforms.bluesky_scenario import STEP_S
from skystack.simulator.simulator import CYCLE_S

with requires_extra(__name__, "bluesky"):
    import bluesky

M_PER_FL, M_S_PER_KT, M_S_PER_FT_MIN = 30.48, 1852.0 / 3600.0, 0.3048 / 60.0
_open: list[Path] = []
"""The folder of the program that is open."""


def open_bluesky(folder: Path) -> None:
    """Start BlueSky in an existing folder; the first start in a process takes some seconds.

    Raises PlatformError if it is already open.
    """
    if _open:
        raise PlatformError("BlueSky is already open in this process (allowed: one at a time)")
    folder = folder.absolute()
    _write_empty_navigation_data(folder)
    with silent():
        if bluesky.traf is None:
            bluesky.init(mode="sim", detached=True, workdir=folder)
        else:
            bluesky.pathfinder.init(folder)
    _open.append(folder)


def close_bluesky() -> None:
    """Allow BlueSky to be opened again."""
    _open.clear()


def clear_bluesky() -> None:
    """Remove all traffic, and set the time to zero."""
    with silent():
        bluesky.sim.reset()


def run_bluesky() -> None:
    """Start the simulation clock."""
    with silent():
        bluesky.sim.op()


def fly_cycle() -> None:
    """Fly one radar cycle."""
    with silent():
        for _ in range(CYCLE_S // STEP_S):
            bluesky.sim.step()


def _write_empty_navigation_data(folder: Path) -> None:
    """Write empty navigation data into the folder, where BlueSky looks before its own.

    Reading BlueSky's takes seconds at the start and 0.1 s at every reset, and is not needed: routes
    are given as positions.
    """
    data = folder / "navdata"
    data.mkdir(exist_ok=True)
    for name in ("nav.dat", "fix.dat", "awy.dat", "airports.dat", "icao-countries.dat"):
        (data / name).touch()
    with ZipFile(data / "apt.zip", "w") as archive:
        archive.writestr("apt.dat", "")


@contextmanager
def silent() -> Iterator[None]:
    """Suppress BlueSky's output and warnings, and restore the warning filters."""
    printed = io.StringIO()
    with warnings.catch_warnings(), redirect_stdout(printed), redirect_stderr(printed):
        warnings.simplefilter("ignore")
        yield


def process(commands: Sequence[str]) -> None:
    """Let BlueSky execute commands now; it does not report refused ones."""
    with silent():
        bluesky.stack.stack(*commands)
        bluesky.stack.process()


def flying() -> list[str]:
    """The callsigns of all aircraft, in BlueSky's order."""
    return list(bluesky.traf.id)


def flight_levels(altitude_m: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Flight levels, rounded so that a level kept in metres equals the cleared one exactly."""
    return np.round(altitude_m / M_PER_FL, 9)
