"""Policies on disk: `policy.safetensors` and `policy.json`. Loading and asking need numpy alone."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from jaxtyping import Float
from safetensors.numpy import load, save

from skystack.errors import InputError, error_context
from skystack.io.files import atomic_write, read_whole
from skystack.io.json_file import MAX_BYTES, check_plain, decode
from skystack.io.names import Name, Seed
from skystack.learning.inference import CLIP, Layers, Normaliser, forward, normalise

FORMAT = 1
MOST_ANSWER = 1e30
"""No answer may be able to come near what a float32 holds."""


class PolicyDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`policy.json`: all that is needed to rebuild and to judge a policy, beside its weights."""

    format: int
    experiment: Name
    seed: Seed
    task_name: str
    task_version: int
    observation: tuple[str, ...]
    actions: tuple[str, ...]
    hidden: Annotated[tuple[int, ...], msgspec.Meta(max_length=100)]
    config: dict[str, Any]
    """The experiment, fully resolved."""
    packages: dict[str, str]
    sha256: str
    """Of `policy.safetensors`."""
    git_revision: str | None = None


@dataclass(frozen=True)
class Policy:
    """A trained policy: a callable from an observation to the most probable action."""

    description: PolicyDescription
    actor: Layers
    normaliser: Normaliser

    @property
    def tensors(self) -> dict[str, np.ndarray]:
        """Its arrays by the names that they have in `policy.safetensors`, float32."""
        tensors = {
            "normaliser.mean": self.normaliser.mean,
            "normaliser.variance": self.normaliser.variance,
        }
        for index, (weights, biases) in enumerate(self.actor):
            tensors[f"actor.{index}.weights"] = weights
            tensors[f"actor.{index}.biases"] = biases
        return {name: np.ascontiguousarray(value, np.float32) for name, value in tensors.items()}

    def logits(self, observation: Float[np.ndarray, "*n observation"]) -> np.ndarray:
        """Unnormalised log probabilities of the actions, float32."""
        result: np.ndarray = forward(self.actor, normalise(self.normaliser, observation))
        return result

    def __call__(self, observation: Float[np.ndarray, " observation"]) -> int:
        """The greedy action. Raises InputError for a wrong shape or non-finite numbers."""
        seen = np.asarray(observation, dtype=np.float32)
        size = len(self.description.observation)
        allowed = f"(allowed: {size} finite numbers)"
        if seen.shape != (size,):
            raise InputError(f"the observation has shape {seen.shape} {allowed}")
        if not np.isfinite(seen).all():
            raise InputError(f"the observation is {seen} {allowed}")
        return int(np.argmax(self.logits(seen)))


def save_policy(folder: Path, policy: Policy) -> None:
    """Write both files; the hash in the description is made to fit."""
    data = save(policy.tensors)
    description = msgspec.structs.replace(
        policy.description, sha256=hashlib.sha256(data).hexdigest()
    )
    text = json.dumps(msgspec.to_builtins(description), indent=2)
    atomic_write(folder / "policy.safetensors", data)
    atomic_write(folder / "policy.json", (text + "\n").encode())


def load_policy(folder: Path) -> Policy:
    """Read a policy back.

    Raises InputError, naming the file, for anything missing, damaged or of another version.
    """
    described, weights = folder / "policy.json", folder / "policy.safetensors"
    with error_context(str(described)):
        text = read_whole(described, MAX_BYTES)
        description = decode(text, PolicyDescription, "not a policy description")
        check_plain(description.config)
    if description.format != FORMAT:
        raise InputError(f"{described}: format {description.format} (allowed: {FORMAT})")
    with error_context(str(weights)):
        data = read_whole(weights)
    if hashlib.sha256(data).hexdigest() != description.sha256:
        raise InputError(f"{weights}: contents do not fit the sha256 in {described.name}")
    try:
        tensors = load(data)
    except Exception as error:  # safetensors raises its own kinds for each kind of damage
        raise InputError(f"{weights}: not a safetensors file: {error}") from None
    return _assemble(description, tensors, weights)


def _assemble(
    description: PolicyDescription, tensors: Mapping[str, np.ndarray], where: Path
) -> Policy:
    sizes = (len(description.observation), *description.hidden, len(description.actions))
    shapes: dict[str, tuple[int, ...]] = {
        "normaliser.mean": sizes[:1],
        "normaliser.variance": sizes[:1],
    }
    for index in range(len(sizes) - 1):
        shapes[f"actor.{index}.weights"] = sizes[index : index + 2]
        shapes[f"actor.{index}.biases"] = sizes[index + 1 : index + 2]
    for name, shape in shapes.items():
        tensor = tensors.get(name)
        if tensor is None or tensor.shape != shape or tensor.dtype != np.float32:
            found = "missing" if tensor is None else f"{tensor.dtype} {tensor.shape}"
            raise InputError(f"{where}: tensor {name!r} is {found} (allowed: float32 {shape})")
        if not np.all(np.isfinite(tensor)):
            raise InputError(f"{where}: tensor {name!r} holds a non-finite number")
    actor = tuple(
        (tensors[f"actor.{index}.weights"], tensors[f"actor.{index}.biases"])
        for index in range(len(sizes) - 1)
    )
    if np.any(tensors["normaliser.variance"] < 0.0):
        raise InputError(f"{where}: tensor 'normaliser.variance' holds a negative number")
    if _greatest(actor, tensors["normaliser.mean"]) > MOST_ANSWER:
        raise InputError(f"{where}: its numbers are so great that its answers would overflow")
    count = np.float32(0.0)
    return Policy(
        description,
        actor,
        Normaliser(tensors["normaliser.mean"], tensors["normaliser.variance"], count),
    )


def _greatest(actor: Layers, mean: Float[np.ndarray, " observation"]) -> float:
    """As far from zero as anything can come on the way to an answer."""
    bound = np.full(len(mean), CLIP)
    greatest = float(np.abs(mean).max(initial=0.0))
    for weights, biases in actor:
        bound = bound @ np.abs(weights.astype(np.float64)) + np.abs(biases.astype(np.float64))
        greatest = max(greatest, float(bound.max(initial=0.0)))
    return greatest


def package_versions() -> dict[str, str]:
    """Versions of what a policy's training depends on."""
    found = {}
    for name in ("skystack", "jax", "jaxlib", "optax", "numpy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
