"""Policies are found by name or folder, and mistakes are explained in one line."""

import shutil

import pytest

from skystack.errors import InputError
from skystack.policies.shipped import SHIPPED, find_policy


def test_a_folder_with_several_policies_lists_some(tmp_path):
    for seed in range(4):
        shutil.copytree(SHIPPED / "vertical", tmp_path / "train" / f"vertical-s{seed}")
    with pytest.raises(InputError) as error:
        find_policy(tmp_path)
    listed = ", ".join(str(tmp_path / "train" / f"vertical-s{seed}") for seed in range(3))
    assert str(error.value) == f"{tmp_path}: has several policies (allowed: one of {listed}, ...)"
    assert find_policy(tmp_path / "train" / "vertical-s3").description.experiment == "vertical"
