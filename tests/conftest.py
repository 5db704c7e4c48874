"""Strictness for all tests: shapes are checked, nothing is promoted or warned about silently."""

import os
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("MPLBACKEND", "Agg")

from jaxtyping import install_import_hook

import tests.typecheck  # noqa: F401  (the hook looks it up by name)

install_import_hook("skystack", "tests.typecheck.typecheck")

import jax  # noqa: E402
import jaxtyping  # noqa: E402
import pytest  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402
from jax._src import compiler  # noqa: E402  (no other way to set XLA's options for some tests)

jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

TESTS = Path(__file__).parent

settings.register_profile(
    "skystack",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("skystack")


@pytest.fixture(scope="session", autouse=True)
def compile_once(tmp_path_factory):
    """Programs that several tests compile alike are compiled once a session."""
    common = tmp_path_factory.getbasetemp().parent  # of all workers
    os.environ["SKYSTACK_CACHE"] = str(common / "programs")  # for commands in their own processes
    jax.config.update("jax_compilation_cache_dir", str(tmp_path_factory.mktemp("compiled")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


@pytest.fixture
def types_unchecked(monkeypatch):
    """Turn type checks off, as for users: values of a wrong type reach the code."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


MEASURED = ("learning", "simulator", "tasks", "test_stacking.py")
"""The tests of what coverage is measured of; to note every line slows Python down."""
QUICKLY = (
    "agents",
    "benchmarking",
    "docs",
    "evaluation",
    "export",
    "gym/test_processes.py",
    "reporting",
    "reproduction",
    "studies",
    "verification/test_killed_trainings.py",
    "verification/test_mutated_inputs.py",
    "tools/test_ship_policies.py",
    "verification/test_signalled_commands.py",
    "learning/test_phases.py",
    "learning/test_run.py",
    "platforms/test_bluesky.py",
    "tasks/test_batch.py",
    "cli/test_catalogue.py",
    "cli/test_cli.py",
    "test_distribution.py",
    "test_examples.py",
    "io/test_names.py",
)
"""Where tests are of what is said and written, not of what is computed: what they run need not be
fast, and is compiled in a third of the time. All others compile as users do."""
_EMITTERS = "xla_cpu_use_fusion_emitters"
QUICK = {"JAX_DISABLE_MOST_OPTIMIZATIONS": "1", "XLA_FLAGS": f"--{_EMITTERS}=false"}
"""The same for commands in processes of their own."""


@pytest.fixture(scope="module", autouse=True)
def compiled_for_the_purpose(request):
    """Programs as users have them, or made quickly; nothing is kept from the one to the other."""
    quickly = _within(request.path, QUICKLY)
    if quickly != _compiling["quickly"]:
        jax.clear_caches()
        jax.config.update("jax_disable_most_optimizations", quickly)
        _compiling["quickly"] = quickly
    with pytest.MonkeyPatch.context() as patch:
        if quickly:
            patch.setattr(compiler, "get_compile_options", _quick_options)
            for variable, value in QUICK.items():
                patch.setenv(variable, value)
        yield


NO_BROWSER = "no Chromium on this machine"
"""Why tests of the replay page are skipped."""


def pytest_terminal_summary(terminalreporter):
    """One line at the end, with the command that brings what is missing."""
    skipped = terminalreporter.stats.get("skipped", [])
    count = sum(NO_BROWSER in str(report.longrepr) for report in skipped)
    if count:
        terminalreporter.write_line(
            f"{count} tests of the replay page were skipped: {NO_BROWSER} (on Debian and Ubuntu, "
            "as root: apt-get install chromium)"
        )


def pytest_collection_modifyitems(items):
    for item in items:
        if not _within(item.path, MEASURED):
            item.add_marker(pytest.mark.no_cover)


def _within(path, parts):
    return any(path.is_relative_to(TESTS / each) for each in parts)


_compiling = {"quickly": False}
_options = compiler.get_compile_options


def _quick_options(*given, env_options_overrides=None, **named):
    overrides = (env_options_overrides or {}) | {_EMITTERS: False}
    return _options(*given, env_options_overrides=overrides, **named)
