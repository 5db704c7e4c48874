"""What is shipped: wheel and source distribution hold the project's files, all that are needed."""

import os
import subprocess
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.conftest import QUICK
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
def built(tmp_path_factory):
    return build(tmp_path_factory.mktemp("built"))


@pytest.fixture(scope="module")
def alone(built, tmp_path_factory):
    """The Python of an environment with the wheel in it, all else borrowed from this one."""
    here = [sysconfig.get_path("purelib"), sysconfig.get_path("platlib")]
    python = make_environment(tmp_path_factory.mktemp("alone"), built[0], here)
    return str(python)


def project(*folders):
    """The project's files: tracked, or to be."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--", *folders]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return {name for name in listed.stdout.splitlines() if (ROOT / name).exists()}


def test_the_wheel_holds_the_package_and_nothing_else(built):
    with zipfile.ZipFile(built[0]) as wheel:
        held = wheel.namelist()
        about = {name for name in held if ".dist-info/" in name}
        (metadata,) = (name for name in about if name.endswith("/METADATA"))
        stated = wheel.read(metadata).decode()
    package = {name.removeprefix("src/") for name in project("src/skystack")}
    assert len(held) == len(set(held))
    assert set(held) - about == package
    for kind in ("policies/*/policy.safetensors", "policies/*/card.md", "experiments/*.toml"):
        assert any(Path(name).match(f"skystack/{kind}") for name in held), kind
    for kind in ("sectors/*.json", "reporting/replay/web/*.js", "reporting/*.jinja", "py.typed"):
        assert any(Path(name).match(f"skystack/{kind}") for name in held), kind
    assert {name.partition("/")[2] for name in about} == {
        *("METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE"),
    }
    assert "License-Expression: Apache-2.0" in stated
    assert "# skystack" in stated  # the README, for an index to show


def test_the_source_distribution_holds_the_project(built):
    with tarfile.open(built[1]) as source:
        held = [name.partition("/")[2] for name in source.getnames()]
    hosting = (".ci/", ".github/", ".pre-commit-config.yaml")
    automation = {name for name in project() if name.startswith(hosting)}
    assert sorted(held) == sorted(project() - automation | {"PKG-INFO"})


def test_the_environment_has_the_wheel_and_no_network(alone, tmp_path):
    said = run_clean([alone, "-c", "import skystack; print(skystack.__file__)"], tmp_path)
    assert Path(said.strip()).is_relative_to(Path(alone).parents[1])
    for asked in ("create_connection(('127.0.0.1', 9))", "gethostbyname('localhost')"):
        with pytest.raises(BrokenError, match="no network here"):
            run_clean([alone, "-c", f"import socket; socket.{asked}"], tmp_path)


def test_the_main_job_from_the_wheel_is_that_of_the_checkout(alone, tmp_path):
    """Bit for bit: without a network on all cores, then on one core with the programs kept."""
    variables = {
        **QUICK,
        "SKYSTACK_CACHE": str(tmp_path / "programs"),
        "JAX_PLATFORMS": "cpu",
    }
    first, second = tmp_path / "wheel", tmp_path / "checkout"
    _, *words = reproduce_command(first, "vertical", 1, SMALL)
    run_clean([*without_network(), alone, *words], tmp_path, **variables)
    one_core = ["taskset", "--cpu-list", str(min(os.sched_getaffinity(0)))]
    again = [*one_core, *reproduce_command(second, "vertical", 1, SMALL)]
    run_clean(again, tmp_path, PYTHONPATH=str(ROOT / "src"), **variables)
    expected, found = contents(first), contents(second)
    assert {"results.json", "train/vertical-s0/policy.safetensors"} <= set(expected)
    assert len([name for name in expected if name.endswith(".parquet")]) == 8
    assert sorted(found) == sorted(expected)
    assert [name for name in expected if found[name] != expected[name]] == []
