"""Find policies by name or file: ours and those of other libraries."""

from pathlib import Path

from skystack.agents.agent import Agent
from skystack.agents.onnx_agent import read_onnx
from skystack.agents.sb3_agent import read_sb3
from skystack.io.files import AnyPath
from skystack.learning.policy import Policy
from skystack.policies.shipped import find_policy

READERS = {".onnx": read_onnx, ".zip": read_sb3}
"""The readers of policy files by suffix."""


def find_agent(name: AnyPath) -> Policy | Agent:
    """The policy in an ONNX (.onnx) or Stable-Baselines3 (.zip) file, or that of `find_policy`.

    Raises InputError if it does not exist or cannot be used.

    Example:

        >>> import skystack
        >>> policy = skystack.find_agent("lateral-best")  # or "model.onnx"
        >>> policy.description.experiment
        'lateral-best'
    """
    path = Path(name)
    read = READERS.get(path.suffix.lower())
    return find_policy(name) if read is None else read(path)
