"""The public names of the package."""

import subprocess
import sys
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
