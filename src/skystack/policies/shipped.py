"""Shipped policies by name, and policies in run folders."""

from importlib.resources import files
from os import fspath
from pathlib import Path

from skystack.errors import InputError, exists, unknown_name
from skystack.io.files import AnyPath
from skystack.learning.policy import Policy, load_policy

MAX_LISTED = 3
"""The maximum number of policies that an error message lists."""
SECTOR_CONTROL = "sector-control"
"""The name of the task and of the policy that control a whole sector."""
SHIPPED = Path(str(files("skystack").joinpath("policies")))


def shipped_policies() -> list[str]:
    """The names of the policies in the package."""
    return sorted(path.parent.name for path in SHIPPED.glob("*/policy.json"))


def scenario_policies() -> list[str]:
    """Those that are evaluated on scenarios, not on hours of traffic like sector control."""
    return [each for each in shipped_policies() if each != SECTOR_CONTROL]


def find_policy(name: AnyPath) -> Policy:
    """A shipped policy by name, or the policy in a run folder.

    Raises InputError if there is neither, or if the policy cannot be used.

    Example:

        >>> import numpy as np
        >>> import skystack
        >>> policy = skystack.find_policy("lateral-best")
        >>> policy.description.actions[1]
        'aircraft 1 turn -10 deg'
        >>> observation = np.full(len(policy.description.observation), 0.5, np.float32)
        >>> policy(observation) in range(len(policy.description.actions))
        True
    """
    name = fspath(name)
    if name in shipped_policies():
        return load_policy(SHIPPED / name)
    folder = Path(name)
    if folder.name == "policy.json":
        folder = folder.parent
    if not exists(folder / "policy.json"):
        if exists(folder / "metrics.jsonl"):
            raise InputError(f"{folder}: training is not finished (resume with train --resume)")
        if exists(folder / "train") and (trained := sorted(folder.glob("train/*/policy.json"))):
            names = ", ".join(str(each.parent) for each in trained[:MAX_LISTED])
            raise InputError(f"{folder}: has several policies (allowed: one of {names}, ...)")
        also = "a folder with a policy.json, or "
        raise unknown_name("policy", name, shipped_policies(), [f"runs/{name}"], also)
    return load_policy(folder)
