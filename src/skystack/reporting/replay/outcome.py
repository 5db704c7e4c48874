"""Why a recorded scenario did not succeed, from the criteria and flights in the tables."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from skystack.simulator.performance import TICKS_PER_FL
from skystack.tasks.rewards import MAX_INSTRUCTIONS

CRITERIA = ("correct_exit", "excursion", "few_clearances")
"""Columns of `episodes.parquet`. Older tables may lack them; then no reason is known."""


class Failure(NamedTuple):
    """One reason why a scenario did not succeed."""

    reason: str
    """`excursion`, `wrong_exit_level`, `not_exited` or `too_many_clearances`."""
    aircraft: tuple[int, ...]
    """The indices of the aircraft that it applies to, if the tables tell."""


class Flown(NamedTuple):
    """What the reasons need to know of one aircraft."""

    status: Sequence[str]
    """One per row, up to the row in which it has exited."""
    end_fl: float
    exit_fl: int
    clearances: int
    correct_exit: bool | None = None
    """Whether it left through its exit at its exit level; None if the tables do not say."""


def counts_clearances(episodes: Iterable[Mapping[str, Any]]) -> bool:
    """Whether few clearances are a criterion, as far as the episodes tell.

    A success with many clearances shows that they are not.
    """
    return not any(
        each.get("success") and not each.get("few_clearances", True) for each in episodes
    )


def failures_of(
    episode: Mapping[str, Any], aircraft: Sequence[Flown], counted: bool
) -> tuple[Failure, ...]:
    """The reasons for a failure; none if there was none, or if the tables lack the criteria.

    For an hour of arriving traffic, all excursions and exits at a wrong level.
    `counted` states whether too many clearances can be a reason.
    """
    if "success" not in episode:
        listed = (
            _reason("excursion", aircraft, lambda each: "excursion" in each.status),
            _reason("wrong_exit_level", aircraft, _is_at_wrong_level),
        )
        return tuple(each for each in listed if each.aircraft)
    if episode["success"] or not set(CRITERIA) <= set(episode):
        return ()
    found = []
    if episode["excursion"]:
        found.append(_reason("excursion", aircraft, lambda each: "excursion" in each.status))
    if not episode["correct_exit"]:
        exits = (
            _reason("wrong_exit_level", aircraft, _is_at_wrong_level),
            _reason("not_exited", aircraft, _is_inside),
        )
        found += [each for each in exits if each.aircraft]
    if counted and not episode["few_clearances"]:
        found.append(
            _reason(
                "too_many_clearances", aircraft, lambda each: each.clearances >= MAX_INSTRUCTIONS
            )
        )
    return tuple(found)


def _reason(reason: str, aircraft: Sequence[Flown], applies: Any) -> Failure:
    return Failure(reason, tuple(number for number, each in enumerate(aircraft) if applies(each)))


def _is_at_wrong_level(aircraft: Flown) -> bool:
    """Levels are compared in ticks, as in the tasks."""
    if aircraft.status[-1] != "exited":
        return False
    if aircraft.correct_exit is not None:
        return not aircraft.correct_exit
    return round(aircraft.end_fl * TICKS_PER_FL) != aircraft.exit_fl * TICKS_PER_FL


def _is_inside(aircraft: Flown) -> bool:
    return aircraft.status[-1] in ("before_entry", "in_sector")
