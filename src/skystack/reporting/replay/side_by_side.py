"""One recording, or two of the same scenarios to be seen side by side."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from skystack.errors import InputError, printable
from skystack.reporting.replay.recording import Replay, ReplayScenario, read_replay

SAME_START_NM = 0.1
"""Other simulators place aircraft as ours does but for rounding."""


def read_side_by_side(
    runs: Sequence[Path], scenarios: int = 100, only: int | None = None
) -> tuple[Replay, ...]:
    """Recordings as of `read_replay`, with the scenarios that they have in common.

    Raises InputError as `read_replay` does, and where two do not belong together.
    """
    replays = tuple(read_replay(path, scenarios, only) for path in runs)
    if len({replay.title for replay in replays}) < len(replays):
        # Of the same name, in different places.
        replays = tuple(
            replace(replay, title=printable(str(path)))
            for replay, path in zip(replays, runs, strict=True)
        )
    return in_common(replays)


def in_common(replays: tuple[Replay, ...]) -> tuple[Replay, ...]:
    """Only the scenarios that all hold.

    Raises InputError where there is none, where recordings are not of one sector or where aircraft
    start elsewhere.
    """
    first = replays[0]
    common = {scenario.number for scenario in first.scenarios}
    for other in replays[1:]:
        common &= _comparable(first, other)

    def kept(replay: Replay) -> Replay:
        return replace(replay, scenarios=tuple(s for s in replay.scenarios if s.number in common))

    return tuple(kept(replay) for replay in replays)


def _comparable(first: Replay, other: Replay) -> set[int]:
    """The numbers of the scenarios that both hold, the same in both."""
    if other.sector != first.sector:
        name, of = first.sector.name, f"{other.title} is of sector {other.sector.name}"
        if other.sector.name == name:
            raise InputError(
                f"{other.title} and {first.title} are of different sectors with the name {name} "
                "(allowed: side by side in one sector)"
            )
        raise InputError(f"{of}, {first.title} of {name} (allowed: side by side in one sector)")
    known = {scenario.number: scenario for scenario in first.scenarios}
    common = [scenario for scenario in other.scenarios if scenario.number in known]
    if not common:
        raise InputError(f"{first.title} and {other.title} have no scenario in common")
    for scenario in common:
        if not _same_start(known[scenario.number], scenario):
            raise InputError(
                f"scenario {scenario.number} of {other.title} begins otherwise than that of "
                f"{first.title} (allowed: side by side the same scenarios)"
            )
    return {scenario.number for scenario in common}


def _same_start(one: ReplayScenario, other: ReplayScenario) -> bool:
    who = [[(each.callsign, each.route) for each in s.aircraft] for s in (one, other)]
    if who[0] != who[1]:
        return False
    start = [np.array([each.position_nm[0] for each in s.aircraft]) for s in (one, other)]
    return bool(np.all(np.abs(start[0] - start[1]) < SAME_START_NM))
