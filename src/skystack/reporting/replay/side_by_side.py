"""Read one recording, or two of the same scenarios to show side by side."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from skystack.errors import InputError, printable
from skystack.evaluation.writing import SESSION
from skystack.reporting.replay.recording import Replay, ReplayScenario, read_replay

SAME_START_NM = 0.1
"""The tolerance of start positions, which other simulators round."""


def read_side_by_side(
    runs: Sequence[Path], scenarios: int | None = None, only: int | None = None
) -> tuple[Replay, ...]:
    """Read recordings, as `read_replay` does, and keep the scenarios that they have in common.

    Raises InputError as `read_replay` and `in_common` do.
    """
    replays = tuple(read_replay(path, scenarios, only) for path in runs)
    if len({replay.title for replay in replays}) < len(replays):
        # The folders have the same name, so the paths become the titles.
        replays = tuple(
            replace(replay, title=printable(str(path)))
            for replay, path in zip(replays, runs, strict=True)
        )
    return in_common(replays)


def in_common(replays: tuple[Replay, ...]) -> tuple[Replay, ...]:
    """Keep only the scenarios that all recordings contain.

    Raises InputError if there are none, if the sectors differ, or if the aircraft or their starts
    differ (for hours of traffic: if the traffic differs).
    """
    first = replays[0]
    common = {scenario.number for scenario in first.scenarios}
    for other in replays[1:]:
        common &= _comparable(first, other)

    def kept(replay: Replay) -> Replay:
        return replace(replay, scenarios=tuple(s for s in replay.scenarios if s.number in common))

    return tuple(kept(replay) for replay in replays)


def _comparable(first: Replay, other: Replay) -> set[int]:
    """The numbers of the scenarios in both recordings. Raises InputError as `in_common` does."""
    if other.sector != first.sector:
        if other.sector.name == first.sector.name:
            raise InputError(
                f"{other.title} and {first.title} have different sectors with the same name, "
                f"{first.sector.name} (allowed: recordings of one sector)"
            )
        raise InputError(
            f"{other.title} is of sector {other.sector.name}, {first.title} of "
            f"{first.sector.name} (allowed: recordings of one sector)"
        )
    if first.traffic is not None or other.traffic is not None:
        _check_traffic(first, other)
    known = {scenario.number: scenario for scenario in first.scenarios}
    common = [scenario for scenario in other.scenarios if scenario.number in known]
    if not common:
        raise InputError(f"{first.title} and {other.title} have no scenario in common")
    for scenario in common if first.traffic is None else ():
        if not _same_start(known[scenario.number], scenario):
            raise InputError(
                f"scenario {scenario.number} of {other.title} starts differently from that of "
                f"{first.title} (allowed: recordings of the same scenarios)"
            )
    return {scenario.number for scenario in common}


def _check_traffic(first: Replay, other: Replay) -> None:
    """Raise InputError unless both are of the same traffic, whatever the agents."""
    if first.traffic is None or not first.traffic.is_same_as(other.traffic):
        raise InputError(
            f"{other.title} and {first.title} have different traffic (allowed: recordings of the "
            "same traffic, seed and uncertainty)"
        )
    if SESSION in {each.traffic.agent for each in (first, other) if each.traffic}:
        return  # the histories of a session may end at any time
    lengths = {scenario.cycles for replay in (first, other) for scenario in replay.scenarios}
    if len(lengths) > 1:
        raise InputError(
            f"{other.title} and {first.title} have hours of different lengths (allowed: equal ones)"
        )


def _same_start(one: ReplayScenario, other: ReplayScenario) -> bool:
    planned = [[(each.callsign, each.route) for each in s.aircraft] for s in (one, other)]
    if planned[0] != planned[1]:
        return False
    start = [np.array([each.position_nm[0] for each in s.aircraft]) for s in (one, other)]
    return bool(np.all(np.abs(start[0] - start[1]) < SAME_START_NM))
