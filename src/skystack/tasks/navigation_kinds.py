"""The paper's tasks, `lateral`, `vertical` and `avoidance`, built from checked settings."""

from collections.abc import Iterator
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from skystack.airspace.geometry import inside_area
from skystack.airspace.sector import Sector
from skystack.airspace.sectors import sector_from
from skystack.errors import InputError, check_known
from skystack.simulator.entries import first_fixes
from skystack.simulator.fleet import fleet
from skystack.simulator.generator import LateralScenarios, VerticalScenarios
from skystack.simulator.limits import MAX_CYCLES
from skystack.simulator.performance import Performance, performance
from skystack.simulator.simulator import Simulator
from skystack.tasks.actions import ActionTable, large_turns, level_changes, small_turns
from skystack.tasks.features import FEATURES
from skystack.tasks.flight_time import FlightTimes, flight_times
from skystack.tasks.kinds import Family, ObservedValue, RewardTerm, TaskDescription, TaskKind
from skystack.tasks.navigation import NavigationTask
from skystack.tasks.pairs import PAIR_FEATURES
from skystack.tasks.rewards import REWARDS
from skystack.tasks.settings import NavigationSettings, RewardSettings

LATERAL = "lateral"
VERTICAL = "vertical"
AVOIDANCE = "avoidance"


def build_navigation(settings: NavigationSettings) -> NavigationTask:
    """The task with the given settings. Raises InputError for contradictory settings."""
    sector = sector_from(settings.sector)
    if settings.levels_fl is not None:
        sector = replace(sector, levels_fl=_checked_levels(settings.levels_fl))
    if settings.exit_nm is not None or settings.exit_before_nm:
        sector = replace(sector, exit_nm=settings.exit_nm, exit_before_nm=settings.exit_before_nm)
        _check_exits(sector)
    vertical = settings.name == VERTICAL
    simulator = Simulator(sector, _performance(settings), own_navigation=vertical)
    check_known("feature in task.features", settings.features, FEATURES)
    check_known("feature in task.pair_features", settings.pair_features, PAIR_FEATURES)
    if not settings.features:
        raise InputError(f"task.features is empty (allowed: {', '.join(sorted(FEATURES))})")
    if vertical != (settings.actions == "levels"):
        allowed = "levels" if vertical else "small, large"
        raise InputError(
            f"task.actions is {settings.actions} (allowed for {settings.name}: {allowed})"
        )
    scenarios = _vertical(settings, simulator) if vertical else _lateral(settings, simulator)
    return NavigationTask(settings, simulator, scenarios, _actions(settings, sector))


def check_navigation_cycles(task: NavigationTask) -> str | None:
    """Check whether the routes can be flown within the task's time limit.

    Returns a notice about the routes that the slowest aircraft cannot fly, or None. Raises
    InputError if even the fastest aircraft cannot fly the shortest route.
    """
    times, cycles = _flight_times(task), task.cycles
    needed = int(times.fastest[times.shortest])
    if needed > cycles:
        route = " ".join(task.sector.routes[times.shortest])
        raise InputError(
            f"task.cycles is {cycles}, but the shortest route of {task.sector.name}, {route}, "
            f"takes {needed} at {times.fastest_kt:.0f} kt (allowed: {needed} to {MAX_CYCLES}; set "
            "it with --cycles, or task.cycles in the TOML)"
        )
    return times.beyond(cycles)


def _flight_times(task: NavigationTask) -> FlightTimes:
    vertical, (low, high) = task.name == VERTICAL, task.sector.levels_fl
    levels = tuple(range(low, high + 1, 10)) if vertical else _levels(task.settings)
    disc_nm = 0.0 if vertical else task.settings.disc_nm
    return flight_times(task.simulator, levels, disc_nm)


def describe_navigation(settings: NavigationSettings) -> TaskDescription:
    """The description of the task with the given settings."""
    reward = settings.reward
    exit_level = " at its exit level" if settings.actions == "levels" else ""
    width = settings.exit_nm
    within = "" if width is None else f", at most {width:g} NM from the middle of the exit"
    airway = settings.airway_nm
    beyond = "" if airway is None else f", also none of more than {airway:g} NM from the route"
    criteria = (
        f"every aircraft leaves through its exit{exit_level}{within}",
        f"there is no excursion{beyond}",
    )
    return TaskDescription(
        summary=_summary(settings),
        observed=tuple(_observed(settings)),
        rewards=tuple(_rewards(reward)),
        criteria=criteria,
        counts_instructions=reward.count_criterion,
        observes_others=bool(settings.pair_features),
    )


def _summary(settings: NavigationSettings) -> str:
    sector = settings.sector if isinstance(settings.sector, str) else settings.sector.name
    if settings.actions == "levels":
        return (
            f"to guide an aircraft through the sector {sector} on own navigation, from its entry "
            "level to its exit level, with climbs and descents"
        )
    levels = ", ".join(f"FL{level}" for level in _levels(settings))
    separated = ", and to keep them separated" if settings.name == AVOIDANCE else ""
    return (
        f"to guide {settings.aircraft} aircraft at {levels} through the sector {sector} to their "
        f"exits, with turns{separated}"
    )


def _observed(settings: NavigationSettings) -> Iterator[ObservedValue]:
    """The observed values of each aircraft, then those of each pair."""
    for name in settings.features:
        each = FEATURES[name]
        yield ObservedValue(name, each.meaning, each.low, each.high)
    for name in settings.pair_features:
        pair = PAIR_FEATURES[name]
        yield ObservedValue(name, f"pair: {pair.meaning}", pair.low, pair.high)


def _rewards(reward: RewardSettings) -> Iterator[RewardTerm]:
    """The weight of each term, followed by its parameters."""
    for name, each in REWARDS.items():
        weight = getattr(reward, name)
        paid = weight != 0.0
        yield RewardTerm(name, f"{each.description}, {each.unit}", weight, paid)
        for key, parameter in each.parameters.items():
            description = f"parameter: {parameter.description}"
            yield RewardTerm(key, description, getattr(reward, key), paid)


def _kind(name: str, title: str, description: str) -> TaskKind:
    return TaskKind(
        family=Family(name, title),
        settings=NavigationSettings,
        build=build_navigation,
        description=description,
        check_cycles=check_navigation_cycles,
        describe=describe_navigation,
    )


NAVIGATION_KINDS = (
    _kind(LATERAL, "Lateral navigation", "follow the route to the exit with headings"),
    _kind(VERTICAL, "Vertical control", "reach the exit level on own navigation"),
    _kind(
        AVOIDANCE,
        "Lateral navigation and avoidance",
        "follow the route with headings and keep aircraft apart",
    ),
)
"""`avoidance` is built like `lateral`. The difference is in the settings of its experiments."""


def _actions(settings: NavigationSettings, sector: Sector) -> ActionTable:
    if settings.actions == "levels":
        return level_changes(settings.aircraft, sector.levels_fl)
    table = small_turns if settings.actions == "small" else large_turns
    return table(settings.aircraft)


def _vertical(settings: NavigationSettings, simulator: Simulator) -> VerticalScenarios:
    if settings.aircraft != 1:
        raise InputError(f"task.aircraft is {settings.aircraft} (allowed for vertical: 1)")
    return VerticalScenarios(simulator, _shares(settings))


def _lateral(settings: NavigationSettings, simulator: Simulator) -> LateralScenarios:
    sector = simulator.sector
    if settings.aircraft > first_fixes(sector):
        raise InputError(
            f"task.aircraft is {settings.aircraft}, but each needs its own first fix and "
            f"{sector.name} has {first_fixes(sector)} (the default is 2 aircraft)"
        )
    levels = _levels(settings)
    low, high = sector.levels_fl
    for level in levels:
        if level % 10 or not low <= level <= high:
            raise InputError(
                f"task.level_fl is {level} (allowed in {sector.name}: multiples of 10 from {low} "
                f"to {high}; the default is 300)"
            )
    return LateralScenarios(
        simulator, settings.aircraft, levels, settings.disc_nm, _shares(settings)
    )


def _levels(settings: NavigationSettings) -> tuple[int, ...]:
    level_fl = settings.level_fl
    return (level_fl,) if isinstance(level_fl, int) else level_fl


def _performance(settings: NavigationSettings) -> Performance:
    if not settings.fleet:
        return performance(settings.performance)
    if settings.performance != "table":
        raise InputError(
            f"task.performance is {settings.performance} (allowed with task.fleet: table)"
        )
    return fleet(settings.fleet)


def _shares(settings: NavigationSettings) -> tuple[float, ...]:
    return tuple(each.share for each in settings.fleet) or (1.0,)


def _checked_levels(levels_fl: tuple[int, int]) -> tuple[int, int]:
    low, high = levels_fl
    if low % 10 or high % 10 or not 0 <= low < high <= 600:
        raise InputError(
            f"task.levels_fl is {list(levels_fl)} (allowed: two multiples of 10 from 0 to 600, "
            "the lower first)"
        )
    return levels_fl


def _check_exits(sector: Sector) -> None:
    """Raise InputError unless all exits are inside the area, on the leg to the exit fix."""
    if not sector.exit_before_nm:
        return
    table = sector.route_table
    leaves = np.flatnonzero(~table.lands)
    if not len(leaves):
        return
    legs_nm = table.leg_nm[leaves, table.exit_fix[leaves] - 1].tolist()
    points = np.array([sector.exit_point_nm(sector.routes[route]) for route in leaves.tolist()])
    inside = np.asarray(inside_area(jnp.asarray(points, dtype=jnp.float32), sector.area_nm))
    if sector.exit_before_nm >= min(legs_nm) or not inside.all():
        raise InputError(
            f"task.exit_before_nm is {sector.exit_before_nm:g} (allowed in {sector.name}: inside "
            f"the area, and less than {min(legs_nm):.1f}, the shortest leg to an exit)"
        )
