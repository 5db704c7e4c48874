"""The wheel and the source distribution contain exactly the files that they should."""

import os
import subprocess
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.conftest import FAST_COMPILE_ENVIRONMENT
from verification.robustness.empty_environment import (
    BrokenError,
    build,
    make_environment,
    run_clean,
    without_network,
)
from verification.robustness.killed_trainings import reproduce_command
from verification.robustness.same_result import contents

ROOT = Path(__file__).parents[1]

SMALL = (
    *("ppo.total_steps=256", "ppo.environments=8", "ppo.steps=32", "ppo.minibatch=64"),
    *("ppo.epochs=1", "task.cycles=104"),
)


@pytest.fixture(scope="module")
def distributions(tmp_path_factory):
    return build(tmp_path_factory.mktemp("built"))


@pytest.fixture(scope="module")
def wheel_python(distributions, tmp_path_factory):
    """The Python of an environment with the wheel; its dependencies come from this environment."""
    here = [sysconfig.get_path("purelib"), sysconfig.get_path("platlib")]
    python = make_environment(tmp_path_factory.mktemp("alone"), distributions[0], here)
    return str(python)


def project_files(*folders):
    """The project's files: tracked, or untracked and not ignored."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *folders]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return {name for name in listed.stdout.splitlines() if (ROOT / name).exists()}


def test_wheel_contains_exactly_the_package(distributions):
    with zipfile.ZipFile(distributions[0]) as wheel:
        names = wheel.namelist()
        metadata_files = {name for name in names if ".dist-info/" in name}
        (metadata,) = (name for name in metadata_files if name.endswith("/METADATA"))
        metadata_text = wheel.read(metadata).decode()
    package = {name.removeprefix("src/") for name in project_files("src/skystack")}
    assert len(names) == len(set(names))
    assert set(names) - metadata_files == package
    for kind in ("policies/*/policy.safetensors", "policies/*/README.md", "experiments/*.toml"):
        assert any(Path(name).match(f"skystack/{kind}") for name in names), kind
    for kind in ("sectors/*.json", "reporting/replay/web/*.js", "reporting/*.jinja", "py.typed"):
        assert any(Path(name).match(f"skystack/{kind}") for name in names), kind
    assert {name.partition("/")[2] for name in metadata_files} == {
        *("METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE"),
    }
    assert "License-Expression: Apache-2.0" in metadata_text
    assert "# skystack" in metadata_text  # the README, shown by package indexes


def test_source_distribution_contains_the_project(distributions):
    with tarfile.open(distributions[1]) as source:
        names = [name.partition("/")[2] for name in source.getnames()]
    hosting = (".ci/", ".github/", ".pre-commit-config.yaml")
    automation = {name for name in project_files() if name.startswith(hosting)}
    assert sorted(names) == sorted(project_files() - automation | {"PKG-INFO"})


@pytest.mark.slow
def test_environment_has_the_wheel_but_no_network(wheel_python, tmp_path):
    output = run_clean([wheel_python, "-c", "import skystack; print(skystack.__file__)"], tmp_path)
    assert Path(output.strip()).is_relative_to(Path(wheel_python).parents[1])
    for call in ("create_connection(('127.0.0.1', 9))", "gethostbyname('localhost')"):
        with pytest.raises(BrokenError, match="no network here"):
            run_clean([wheel_python, "-c", f"import socket; socket.{call}"], tmp_path)


@pytest.mark.slow
def test_wheel_and_checkout_reproduce_identical_results(wheel_python, tmp_path):
    """Bit for bit: offline on all cores, then on one core with cached programs."""
    variables = {
        **FAST_COMPILE_ENVIRONMENT,
        "SKYSTACK_CACHE": str(tmp_path / "programs"),
        "JAX_PLATFORMS": "cpu",
    }
    first, second = tmp_path / "wheel", tmp_path / "checkout"
    _, *arguments = reproduce_command(first, "vertical", 1, SMALL)
    run_clean([*without_network(), wheel_python, *arguments], tmp_path, **variables)
    one_core = ["taskset", "--cpu-list", str(min(os.sched_getaffinity(0)))]
    command = [*one_core, *reproduce_command(second, "vertical", 1, SMALL)]
    run_clean(command, tmp_path, PYTHONPATH=str(ROOT / "src"), **variables)
    expected, found = contents(first), contents(second)
    assert {"results.json", "train/vertical-s0/policy.safetensors"} <= set(expected)
    assert len([name for name in expected if name.endswith(".parquet")]) == 12
    assert sorted(found) == sorted(expected)
    assert [name for name in expected if found[name] != expected[name]] == []
