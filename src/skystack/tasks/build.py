"""From settings to a task, with every name checked."""

from skystack.airspace.sector import Sector
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError, unknown_name
from skystack.simulator.generator import LateralScenarios, first_fixes
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.tasks.actions import large_turns, small_turns
from skystack.tasks.contract import Task
from skystack.tasks.features import FEATURES
from skystack.tasks.lateral import LateralTask
from skystack.tasks.settings import TaskSettings
from skystack.tasks.stacked_steps import StackedSteps

SECTORS = {"x-plus": x_plus}
TASKS = ("lateral",)


def sector_named(name: str) -> Sector:
    """The sector of a name. Raises InputError for an unknown one."""
    if name not in SECTORS:
        raise unknown_name("sector", name, SECTORS)
    return SECTORS[name]()


def build_task(settings: TaskSettings) -> LateralTask:
    """The task as it is flown and judged. Raises InputError for settings that cannot be."""
    sector = sector_named(settings.sector)
    simulator = Simulator(sector, performance(settings.performance))
    for feature in settings.features:
        if feature not in FEATURES:
            raise unknown_name("feature in task.features", feature, FEATURES)
    if not settings.features:
        raise InputError(f"task.features is empty (allowed: {', '.join(sorted(FEATURES))})")
    if settings.aircraft > first_fixes(simulator):
        raise InputError(
            f"task.aircraft is {settings.aircraft}, but each needs a first fix of its own and "
            f"{sector.name} has {first_fixes(simulator)}"
        )
    low, high = sector.levels_fl
    if settings.level_fl % 10 or not low <= settings.level_fl <= high:
        raise InputError(
            f"task.level_fl is {settings.level_fl} (allowed: multiples of 10 from {low} to {high})"
        )
    scenarios = LateralScenarios(simulator, settings.aircraft, settings.level_fl, settings.disc_nm)
    table = small_turns if settings.actions == "small" else large_turns
    return LateralTask(settings, simulator, scenarios, table(settings.aircraft))


def build_training_task(settings: TaskSettings) -> Task:
    """The task as the learner steps through it."""
    task = build_task(settings)
    return StackedSteps(task) if settings.timing == "stack" else task
