"""The public names of the package."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import skystack


def test_every_public_name_exists_and_is_documented():
    assert set(skystack._MODULES) == set(skystack.__all__) - {"__version__"}
    for name in skystack._MODULES:
        value = getattr(skystack, name)
        assert value.__doc__
        assert value.__module__ == f"skystack.{skystack._MODULES[name]}"
        assert name in dir(skystack)
        if name[0].islower():
            assert f"    {name} " in skystack.__doc__
    with pytest.raises(AttributeError, match="has no attribute 'stak'"):
        skystack.stak  # noqa: B018


def test_package_is_marked_as_typed():
    assert (Path(skystack.__file__).parent / "py.typed").exists()


def test_import_loads_no_heavy_library():
    """Public names are imported lazily; `stack` needs none of these libraries."""
    program = (
        "import sys, skystack; skystack.stack; skystack.InputError;"
        "print([m for m in ('jax', 'numpy', 'matplotlib', 'gymnasium') if m in sys.modules])"
    )
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "[]", done.stderr


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


@pytest.mark.slow
def test_a_missing_extra_is_named():
    """With all optional packages hidden, imports fail only with an error naming the extra."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    program = [sys.executable, "-c", WITHOUT_EXTRAS, *HIDDEN]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    found = [re.fullmatch(NEEDS, line).groups() for line in done.stdout.splitlines()]
    assert {module for module, _, _ in found} == {
        "skystack.gym.flights",
        "skystack.gym.multi_agent",
        "skystack.gym.sb3",
        "skystack.live.server",
        "skystack.platforms.bluebird",
        "skystack.platforms.bluesky_program",
    }
    for _, package, extra in found:
        assert any(line.startswith(HIDDEN[package]) for line in extras[extra])


HIDDEN = {
    "bluebird_dt": "bluebird-dt",
    "bluesky": "bluesky-simulator",
    "imageio_ffmpeg": "imageio-ffmpeg",
    "onnx": "onnx",
    "onnxruntime": "onnxruntime",
    "pebble": "pebble",
    "pettingzoo": "pettingzoo",
    "ray": "ray",
    "stable_baselines3": "stable-baselines3",
    "starlette": "starlette",
    "tensorboardX": "tensorboardX",
    "torch": "torch",
    "uvicorn": "uvicorn",
    "websockets": "websockets",
}
"""Optional modules, and the packages that contain them."""
NEEDS = r"(\S+) needs (\w+), which is not installed \(install skystack with the extra \[(\w+)\]; .*"
ROOT = Path(__file__).parents[1]
