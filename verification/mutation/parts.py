"""The modules that `verification.mutation.run` changes, and the tests that should detect it."""

import tomllib
from pathlib import Path

BASE = ("tests.conftest", "skystack.simulator.generator", "optax", "pyarrow", "scipy.stats")
TASKS = (*BASE, "skystack.tasks.registry")
LEARNING = (*TASKS, "skystack.learning.policy")
PRELOADED = {
    "stacking": BASE,
    "tasks": BASE,
    "learning": TASKS,
    "platforms": TASKS,
    "evaluation": LEARNING,
    "gym": LEARNING,
    "reporting": (*LEARNING, "matplotlib.figure", "matplotlib.backends.backend_agg"),
}
"""The packages that can be changed, and the modules imported once for all their tests. These must
not import any module of the package."""

CHOSEN = {
    "stacking": ("stacking.py",),
    "reporting": tuple(
        f"reporting/{name}.py"
        for name in ("claims", "comparison", "labels", "results", "tables", "typical")
    ),
}
"""The changed modules of packages of which not all are changed."""

BUILD, CYCLES = "tests/tasks/test_build.py", "tests/tasks/test_cycle_rewards.py"
TRACKING = "tests/tasks/test_tracking.py"
TESTS = {
    "stacking.py": ("tests/test_stacking.py",),
    "tasks/contract.py": (CYCLES,),
    "tasks/features.py": (TRACKING,),
    "tasks/instruction_counts.py": (TRACKING, CYCLES),
    "tasks/kinds.py": ("tests/tasks/test_registry.py",),
    "tasks/metrics.py": ("tests/tasks/test_navigation.py", CYCLES),
    "tasks/navigation.py": (CYCLES,),
    "tasks/navigation_kinds.py": (BUILD, "tests/tasks/test_flight_time.py"),
    "tasks/pairs.py": (CYCLES,),
    "tasks/programs.py": ("tests/tasks/test_plain.py", "tests/gym/test_copies.py"),
    "tasks/progress.py": (TRACKING,),
    "tasks/registry.py": (BUILD,),
    "tasks/rewards.py": (CYCLES,),
    "tasks/separation.py": (TRACKING,),
    "tasks/settings.py": (BUILD,),
    "tasks/wrapper.py": (BUILD, "tests/tasks/test_batch.py"),
    "learning/advantages.py": ("tests/learning/test_ppo.py", "tests/learning/test_ppo_many.py"),
    "learning/inference.py": ("tests/learning/test_network.py",),
    "learning/network.py": ("tests/learning/test_ppo.py",),
    "platforms/bluebird.py": (
        "tests/platforms/test_fleets.py",
        "tests/platforms/test_longitudes.py",
    ),
    "platforms/bluesky.py": ("tests/platforms/test_fleets.py",),
    "platforms/instruction.py": ("tests/platforms/test_phraseology.py",),
    "platforms/own.py": ("tests/platforms/test_flight.py",),
    "platforms/protocol.py": ("tests/platforms/test_flight.py",),
    "evaluation/columns.py": ("tests/evaluation/test_stored.py",),
    "evaluation/evaluate.py": (
        "tests/evaluation/test_evaluation.py",
        "tests/evaluation/test_platform_rollout.py",
    ),
    "evaluation/hosted.py": ("tests/evaluation/test_rollout.py",),
    "evaluation/paper.py": ("tests/evaluation/test_summary.py",),
    "evaluation/platform_rollout.py": ("tests/evaluation/test_rollout.py",),
    "evaluation/rollout.py": ("tests/evaluation/test_evaluation.py",),
    "gym/environment.py": ("tests/gym/test_radar.py",),
    "gym/vector.py": ("tests/gym/test_radar.py", "tests/gym/test_sb3.py"),
}
"""Tests of a module in addition to those of its own name. A module without either is tested by all
tests of its package."""

LEFT_OUT = (
    *("same_clearances", "jit_stack_alike", "no_physical_state", "half_a_turn"),  # stacking
    *("satisfies_the_contract", "flies_like_its_scenarios"),  # tasks
    *("starts_of_a_hairpin", "a_climb_of_150_levels", "uninstructed"),
    *("agree_with_geometry", "still_costs", "is_an_excursion", "papers_table"),
    *("a_crowd_begins", "bends_in_the_plane", "stacks_like_a_compiled"),
    *("known_answer", "known_solution", "bit_identical", "is_compiled_once"),  # learning
)
"""Parts of the names of tests that are not run: whole flights and training runs, which take long
and detect few changes that the small cases do not."""

IN_PROCESSES = frozenset({"gym/vector.py", "platforms/processes.py", "platforms/guard.py"})
"""Modules that tests also run in other processes, where the executed lines are not recorded: all
their changes are tried."""


def modules(root: Path, package: str) -> tuple[str, ...]:
    """The changed modules of a package, relative to `src/skystack`."""
    source = root / "src" / "skystack"
    found = sorted(str(path.relative_to(source)) for path in (source / package).glob("*.py"))
    return CHOSEN.get(package) or tuple(name for name in found if not name.endswith("__init__.py"))


def tests(root: Path, module: str) -> tuple[str, ...]:
    """The test files nearest to a module."""
    path = Path("tests", module)
    own = path.with_name(f"test_{path.name}")
    named = [str(own)] if (root / own).exists() else []
    extra = [name for name in TESTS.get(module, ()) if name not in named]
    rest = sorted(str(each.relative_to(root)) for each in (root / path.parent).glob("test_*.py"))
    return tuple(named + extra or rest)


def equivalent(package: str) -> dict[tuple[str, str, str], str]:
    """The reasons why changes are equivalent, by module and changed lines.

    They are listed in `equivalent_mutants/PACKAGE.toml`, by module: `before`, `after` and `why`.
    """
    path = Path(__file__).parent / "equivalent_mutants" / f"{package}.toml"
    if not path.exists():
        return {}
    return {
        (module, each["before"], each["after"]): each["why"]
        for module, changes in tomllib.loads(path.read_text()).items()
        for each in changes
    }
