"""The public names of the package."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import skystack


def test_every_public_name_is_there_and_documented():
    assert set(skystack._MODULES) == set(skystack.__all__) - {"__version__"}
    for name in skystack._MODULES:
        found = getattr(skystack, name)
        assert found.__doc__
        assert found.__module__ == f"skystack.{skystack._MODULES[name]}"
        assert name in dir(skystack)
        if name[0].islower():
            assert f"    {name} " in skystack.__doc__
    with pytest.raises(AttributeError, match="has no attribute 'stak'"):
        skystack.stak  # noqa: B018


def test_the_package_says_that_it_is_typed():
    assert (Path(skystack.__file__).parent / "py.typed").exists()


def test_importing_it_loads_no_heavy_library():
    """Names come when they are used; `stack` itself needs none of them at all."""
    program = (
        "import sys, skystack; skystack.stack; skystack.InputError;"
        "print([m for m in ('jax', 'numpy', 'matplotlib', 'gymnasium') if m in sys.modules])"
    )
    command = [sys.executable, "-c", program]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.stdout.strip() == "[]", found.stderr


WITHOUT_EXTRAS = """
import importlib, pkgutil, sys
import skystack

class Hidden:
    def find_spec(name, *_):
        if name.partition(".")[0] in sys.argv[1:]:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hidden)
for module in pkgutil.walk_packages(skystack.__path__, "skystack."):
    if module.name != "skystack.__main__":
        try:
            importlib.import_module(module.name)
        except skystack.InputError as error:
            assert isinstance(error, ImportError)
            print(error)
"""


def test_without_its_extra_a_module_names_it():
    """All that is not required is hidden; nothing else of a module's import may fail."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    program = [sys.executable, "-c", WITHOUT_EXTRAS, *HIDDEN]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    found = [re.fullmatch(NEEDS, line).groups() for line in done.stdout.splitlines()]
    assert {module for module, _, _ in found} == {
        "skystack.gym.multi_agent",
        "skystack.gym.sb3",
        "skystack.platforms.bluebird",
        "skystack.platforms.bluesky",
    }
    for _, package, extra in found:
        assert any(line.startswith(HIDDEN[package]) for line in extras[extra])


HIDDEN = {
    "bluebird_dt": "bluebird-dt",
    "bluesky": "bluesky-simulator",
    "onnx": "onnx",
    "onnxruntime": "onnxruntime",
    "pebble": "pebble",
    "pettingzoo": "pettingzoo",
    "ray": "ray",
    "stable_baselines3": "stable-baselines3",
    "tensorboardX": "tensorboardX",
    "torch": "torch",
}
"""Modules and the packages that they come in."""
NEEDS = r"(\S+) needs (\w+), not installed here \(install skystack with the extra \[(\w+)\]\)"
ROOT = Path(__file__).parents[1]
