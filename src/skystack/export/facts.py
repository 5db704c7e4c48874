"""What an exported policy says about itself, under the names of `policy.json`."""

from typing import Any

from skystack.learning.policy import Policy

FACTS = (
    "experiment",
    "seed",
    "task_name",
    "task_version",
    "observation",
    "actions",
    "sha256",
)
"""The part of the description that travels; `sha256` is that of `policy.safetensors`."""


def facts(policy: Policy) -> dict[str, Any]:
    """What a policy is, sees and means by its outputs: numbers, texts, tuples of texts."""
    return {name: getattr(policy.description, name) for name in FACTS}
