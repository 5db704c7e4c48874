"""A training does not depend on how many cores it is given."""

import subprocess
import sys

import pytest

from skystack.compilation.cores import cores

FEW = ("ppo.total_steps=8192", "ppo.environments=64", "ppo.epochs=2")


def trained_on(numbers, folder):
    words = ["train", "lateral", "--out", str(folder)]
    words += [word for change in FEW for word in ("--set", change)]
    program = (
        "import os; from skystack.cli import main; "
        f"os.sched_setaffinity(0, {set(numbers)}); raise SystemExit(main({words}))"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
    return (folder / "policy.safetensors").read_bytes()


@pytest.mark.skipif(len(cores()) < 2, reason="has one core")
def test_one_core_and_several_train_the_same_policy(tmp_path):
    alone = trained_on(cores()[:1], tmp_path / "alone")
    assert trained_on(cores(), tmp_path / "together") == alone
