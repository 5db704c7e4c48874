"""From settings to a task, with every name checked."""

from collections.abc import Iterable
from dataclasses import replace

from skystack.airspace.sector import Sector
from skystack.airspace.sectors import sector_from
from skystack.errors import InputError, unknown_name
from skystack.simulator.fleet import fleet
from skystack.simulator.generator import LateralScenarios, VerticalScenarios, first_fixes
from skystack.simulator.performance import Performance, performance
from skystack.simulator.simulator import Simulator
from skystack.tasks.actions import ActionTable, LevelTable, large_turns, small_turns
from skystack.tasks.contract import Task
from skystack.tasks.features import FEATURES
from skystack.tasks.flight_time import FlightTimes, flight_times
from skystack.tasks.navigation import NavigationTask
from skystack.tasks.pairs import PAIR_FEATURES
from skystack.tasks.settings import MOST_CYCLES, TaskSettings
from skystack.tasks.stacked_steps import StackedSteps

TASKS = ("lateral", "vertical", "avoidance")


def build_task(settings: TaskSettings) -> NavigationTask:
    """The task as it is flown and judged. Raises InputError for settings that cannot be."""
    if not isinstance(settings, TaskSettings):  # an experiment, most likely
        raise InputError(
            f"settings is of type {type(settings).__name__} (allowed: TaskSettings, as "
            "load_experiment(NAME).task)"
        )
    sector = sector_from(settings.sector)
    if settings.levels_fl is not None:
        sector = replace(sector, levels_fl=_checked_levels(settings.levels_fl))
    vertical = settings.name == "vertical"
    simulator = Simulator(sector, _performance(settings), own_navigation=vertical)
    _check_names("features", settings.features, FEATURES)
    _check_names("pair_features", settings.pair_features, PAIR_FEATURES)
    if not settings.features:
        raise InputError(f"task.features is empty (allowed: {', '.join(sorted(FEATURES))})")
    if vertical != (settings.actions == "levels"):
        allowed = "levels" if vertical else "small, large"
        raise InputError(
            f"task.actions is {settings.actions} (allowed for {settings.name}: {allowed})"
        )
    scenarios = _vertical(settings, simulator) if vertical else _lateral(settings, simulator)
    return NavigationTask(settings, simulator, scenarios, _actions(settings, sector))


def _flight_times(task: NavigationTask) -> FlightTimes:
    vertical, (low, high) = task.name == "vertical", task.sector.levels_fl
    levels = tuple(range(low, high + 1, 10)) if vertical else _levels(task.settings)
    disc_nm = 0.0 if vertical else task.settings.disc_nm
    return flight_times(task.simulator, levels, disc_nm)


def check_cycles(task: NavigationTask) -> str | None:
    """Whether the routes can be flown within the task's cycles, before training or judging.

    Raises InputError where not even the fastest can fly the shortest. Returns a line on the routes
    that the slowest cannot, if there are any.
    """
    times, cycles = _flight_times(task), task.settings.cycles
    needed = int(times.fastest[times.shortest])
    if needed > cycles:
        route = " ".join(task.sector.routes[times.shortest])
        raise InputError(
            f"task.cycles is {cycles}, but the shortest route of {task.sector.name}, {route}, "
            f"takes {needed} at {times.fastest_kt:.0f} kt (allowed: {needed} to {MOST_CYCLES}; "
            "--cycles or task.cycles in the TOML raises it)"
        )
    return times.beyond(cycles)


def _actions(settings: TaskSettings, sector: Sector) -> ActionTable:
    if settings.actions == "levels":
        return LevelTable(settings.aircraft, sector.levels_fl)
    table = small_turns if settings.actions == "small" else large_turns
    return table(settings.aircraft)


def _vertical(settings: TaskSettings, simulator: Simulator) -> VerticalScenarios:
    if settings.aircraft != 1:
        raise InputError(f"task.aircraft is {settings.aircraft} (allowed for vertical: 1)")
    return VerticalScenarios(simulator, _shares(settings))


def _lateral(settings: TaskSettings, simulator: Simulator) -> LateralScenarios:
    sector = simulator.sector
    if settings.aircraft > first_fixes(simulator):
        raise InputError(
            f"task.aircraft is {settings.aircraft}, but each needs a first fix of its own and "
            f"{sector.name} has {first_fixes(simulator)} (2 aircraft where none is given)"
        )
    levels = _levels(settings)
    low, high = sector.levels_fl
    for level in levels:
        if level % 10 or not low <= level <= high:
            raise InputError(
                f"task.level_fl is {level} (allowed in {sector.name}: multiples of 10 from {low} "
                f"to {high}; 300 where none is given)"
            )
    return LateralScenarios(
        simulator, settings.aircraft, levels, settings.disc_nm, _shares(settings)
    )


def _levels(settings: TaskSettings) -> tuple[int, ...]:
    given = settings.level_fl
    return (given,) if isinstance(given, int) else given


def _performance(settings: TaskSettings) -> Performance:
    if not settings.fleet:
        return performance(settings.performance)
    if settings.performance != "table":
        raise InputError(
            f"task.performance is {settings.performance} (allowed with task.fleet: table)"
        )
    return fleet(settings.fleet)


def _shares(settings: TaskSettings) -> tuple[float, ...]:
    return tuple(each.share for each in settings.fleet) or (1.0,)


def _checked_levels(levels_fl: tuple[int, int]) -> tuple[int, int]:
    low, high = levels_fl
    if low % 10 or high % 10 or not 0 <= low < high <= 600:
        raise InputError(
            f"task.levels_fl is {list(levels_fl)} (allowed: two multiples of 10 from 0 to 600, "
            "the lower first)"
        )
    return levels_fl


def _check_names(where: str, names: tuple[str, ...], known: Iterable[str]) -> None:
    for name in names:
        if name not in known:
            raise unknown_name(f"feature in task.{where}", name, known)


def build_training_task(settings: TaskSettings) -> Task:
    """The task as the learner steps through it."""
    task = build_task(settings)
    return StackedSteps(task) if settings.timing == "stack" else task
