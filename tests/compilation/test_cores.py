"""Training does not depend on the number of cores."""

import subprocess
import sys

import pytest

from skystack.compilation.cores import cores

SMALL = ("ppo.total_steps=8192", "ppo.environments=64", "ppo.epochs=2")


def train_on(cores_to_use, folder):
    arguments = ["train", "lateral", "--out", str(folder)]
    arguments += [word for change in SMALL for word in ("--set", change)]
    program = (
        "import os; from skystack.cli import main; "
        f"os.sched_setaffinity(0, {set(cores_to_use)}); raise SystemExit(main({arguments}))"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
    return (folder / "policy.safetensors").read_bytes()


@pytest.mark.slow
@pytest.mark.skipif(len(cores()) < 2, reason="needs two cores")
def test_one_core_and_several_train_the_same_policy(tmp_path):
    one_core = train_on(cores()[:1], tmp_path / "alone")
    assert train_on(cores(), tmp_path / "together") == one_core
