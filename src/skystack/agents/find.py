"""Policies by name or file: ours, and those of other libraries."""

from pathlib import Path

from skystack.agents.agent import Agent
from skystack.agents.onnx_agent import read_onnx
from skystack.agents.sb3_agent import read_sb3
from skystack.io.files import AnyPath
from skystack.learning.policy import Policy
from skystack.policies.shipped import find_policy

READERS = {".onnx": read_onnx, ".zip": read_sb3}
"""By the end of the file's name."""


def find_agent(name: AnyPath) -> Policy | Agent:
    """A policy as `find_policy` finds it, or that in an ONNX (.onnx) or SB3 (.zip) file.

    Raises InputError when there is none, or it cannot be used.
    """
    path = Path(name)
    read = READERS.get(path.suffix.lower())
    return find_policy(name) if read is None else read(path)
