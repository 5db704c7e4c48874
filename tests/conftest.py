"""Set-up of all tests: shapes are checked, and arrays are never promoted implicitly."""

import os
import shutil
import tempfile
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ.setdefault("MPLBACKEND", "Agg")

from jaxtyping import install_import_hook

import tests.typecheck  # noqa: F401  (the import hook finds it by name)

install_import_hook("skystack", "tests.typecheck.typecheck")

import jax  # noqa: E402
import jaxtyping  # noqa: E402
import pytest  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402
from jax._src import compiler  # noqa: E402  (there is no public way to set XLA options per test)
from jax._src.lib.mlir import ir  # noqa: E402  (nor to see what is compiled)
from jax._src.lru_cache import _CACHE_SUFFIX, LRUCache  # noqa: E402  (nor to write atomically)

from skystack.compilation.memory import return_freed_memory  # noqa: E402

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
def compile_once(tmp_path_factory, worker_id):
    """Cache compiled programs, so that each is compiled once per session, by any worker.

    In the folder SKYSTACK_TEST_CACHE, if it is set, they are kept for later sessions.
    """
    common = tmp_path_factory.getbasetemp()
    if worker_id != "master":
        common = common.parent  # shared by all workers
    folder = Path(os.environ.get("SKYSTACK_TEST_CACHE", common / "compiled"))
    os.environ["SKYSTACK_CACHE"] = str(folder / "commands")  # for commands in subprocesses
    LRUCache.put = _put
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_enable_xla_caches", "none")
    # Small programs as well: there are many, and reading one takes a fifth of the time.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def _put(self, key, value):
    """JAX's own function writes in place, where another worker may read half a program."""
    with tempfile.NamedTemporaryFile(dir=self.path, delete=False) as file:
        file.write(value)
    Path(file.name).replace(Path(self.path, f"{key}{_CACHE_SUFFIX}"))


@pytest.fixture
def types_unchecked(monkeypatch):
    """Disable type checks, as for users, so that values of a wrong type reach the code."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


COVERED = ("learning", "simulator", "tasks", "test_stacking.py")
"""Tests that run with coverage. For the others it is disabled, because it slows Python down."""
FAST_COMPILE = (
    "agents",
    "benchmarking",
    "cli",
    "docs",
    "evaluation",
    "export",
    "live",
    "gym/test_copies.py",
    "gym/test_flights.py",
    "gym/test_multi_agent.py",
    "gym/test_processes.py",
    "gym/test_radar.py",
    "gym/test_registration.py",
    "gym/test_sb3.py",
    "gym/test_sector.py",
    "reporting",
    "reproduction",
    "studies",
    "verification/test_killed_trainings.py",
    "verification/test_mutated_inputs.py",
    "verification/test_recorded_hours.py",
    "tools/test_ship_policies.py",
    "verification/test_signalled_commands.py",
    "learning/test_phases.py",
    "learning/test_run.py",
    "platforms/test_bluesky.py",
    "tasks/test_leaving.py",
    "tasks/test_registry.py",
    "tasks/test_stacked_steps.py",
    "tasks/test_batch.py",
    "test_distribution.py",
    "test_examples.py",
    "io/test_names.py",
)
"""Tests of output rather than of computed values. Their programs are compiled without most
optimisations, in a third of the time. In all other tests, only small programs are (`SMALL`)."""
SMALL = 20
"""Programs with at most this many operations are compiled without most optimisations in all tests.
There are thousands of them, most with a single operation: optimising takes longer than running."""
_EMITTERS = "xla_cpu_use_fusion_emitters"
FAST_COMPILE_ENVIRONMENT = {
    "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",
    "XLA_FLAGS": f"--{_EMITTERS}=false",
}
"""The same options, as environment variables for commands in subprocesses."""


@pytest.fixture(scope="module", autouse=True)
def compiler_optimisations(request):
    """Compile with or without most optimisations.

    JAX's caches are cleared between the two, and when they take too much memory. The programs are
    then traced again and read from the cache on disk.
    """
    fast = _within(request.path, FAST_COMPILE)
    if _compiling["fast"] != fast or _is_large():
        jax.clear_caches()
        return_freed_memory()
        _compiling["fast"] = fast
    with pytest.MonkeyPatch.context() as patch:
        if fast:
            for variable, value in FAST_COMPILE_ENVIRONMENT.items():
                patch.setenv(variable, value)
        yield


@pytest.fixture
def one_process(monkeypatch):
    """Fly in one process on other platforms: every process imports their packages for itself."""
    from skystack.platforms import processes

    first = processes.cores()[:1]
    monkeypatch.setattr(processes, "cores", lambda: first)


NO_BROWSER = "no Chromium on this machine"
"""The reason for skipping tests of pages in a browser."""


@pytest.fixture(scope="module")
def browser():
    from tests.reporting.replay.browser import ARGUMENTS, TIMEOUT_MS

    sync_api = pytest.importorskip("playwright.sync_api")
    executable = shutil.which("chromium") or shutil.which("chromium-browser")
    if executable is None:
        pytest.skip(NO_BROWSER)
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=executable, args=ARGUMENTS, timeout=TIMEOUT_MS
        )
        yield chromium
        chromium.close()


def pytest_terminal_summary(terminalreporter, config):
    """Print which tests were left out, and how to run them."""
    if config.option.markexpr == "not slow":
        terminalreporter.write_line(
            "slow tests were left out: `python3 dev.py test --all` runs all tests"
        )
    skipped = terminalreporter.stats.get("skipped", [])
    count = sum(NO_BROWSER in str(report.longrepr) for report in skipped)
    if count:
        terminalreporter.write_line(
            f"{count} tests of HTML pages were skipped: {NO_BROWSER} (on Debian and Ubuntu, "
            "as root: apt-get install chromium)"
        )


def pytest_configure(config):
    """Distribute files in the order of the collection, not those with most tests first."""
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items):
    """Each worker changes the compiler's options only once."""
    items.sort(key=lambda item: not _within(item.path, FAST_COMPILE))
    for item in items:
        if not _within(item.path, COVERED):
            item.add_marker(pytest.mark.no_cover)


def _within(path, parts):
    return any(path.is_relative_to(TESTS / each) for each in parts)


def _is_large():
    """Whether this process uses too much memory: all workers may use a third of the machine's."""
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    try:
        used = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:  # not Linux
        return True
    return used > os.sysconf("SC_PHYS_PAGES") / 3 / workers


_compiling = {"fast": False}
_default_compile = compiler.compile_or_get_cached


def _compile(backend, module, devices, options, *rest, **keywords):
    """Compile without most optimisations where the values do not matter or are simple."""
    if _compiling["fast"] or _is_small(module):
        options.env_option_overrides = [*options.env_option_overrides, (_EMITTERS, False)]
        debugging = options.executable_build_options.debug_options
        debugging.xla_backend_optimization_level = 0
        debugging.xla_llvm_disable_expensive_passes = True
    return _default_compile(backend, module, devices, options, *rest, **keywords)


def _is_small(module):
    operations = 0

    def count(_operation):
        nonlocal operations
        operations += 1
        return ir.WalkResult.ADVANCE if operations <= SMALL else ir.WalkResult.INTERRUPT

    module.operation.walk(count)
    return operations <= SMALL


compiler.compile_or_get_cached = _compile
