"""Policy files: `policy.safetensors` and `policy.json`. Loading and inference need numpy only."""

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
MAX_NETWORK_VALUE = 1e30
"""The limit for the bound on the network's values, far below the largest float32."""


class PolicyDescription(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """`policy.json`: all that is needed to rebuild and evaluate a policy, except its weights."""

    format: int
    experiment: Name
    seed: Seed
    task_name: str
    task_version: int
    observation: tuple[str, ...]
    actions: tuple[str, ...]
    hidden: Annotated[tuple[int, ...], msgspec.Meta(max_length=100)]
    config: dict[str, Any]
    """The fully resolved experiment."""
    packages: dict[str, str]
    """The versions of skystack and its main dependencies."""
    sha256: str
    """The hash of `policy.safetensors`."""
    git_revision: str | None = None


@dataclass(frozen=True)
class Policy:
    """A trained policy. Calling it maps an observation to the most probable action."""

    description: PolicyDescription
    actor: Layers
    normaliser: Normaliser

    @property
    def tensors(self) -> dict[str, np.ndarray]:
        """The float32 arrays of the policy by their names in `policy.safetensors`."""
        tensors = {
            "normaliser.mean": self.normaliser.mean,
            "normaliser.variance": self.normaliser.variance,
        }
        for index, (weights, biases) in enumerate(self.actor):
            tensors[f"actor.{index}.weights"] = weights
            tensors[f"actor.{index}.biases"] = biases
        return {name: np.ascontiguousarray(value, np.float32) for name, value in tensors.items()}

    def logits(self, observation: Float[np.ndarray, "*n observation"]) -> np.ndarray:
        """Unnormalised log-probabilities of the actions; float32."""
        result: np.ndarray = forward(self.actor, normalise(self.normaliser, observation))
        return result

    def __call__(self, observation: Float[np.ndarray, " observation"]) -> int:
        """The greedy action. Raises InputError for a wrong shape or non-finite numbers."""
        values = np.asarray(observation, dtype=np.float32)
        size = len(self.description.observation)
        allowed = f"(allowed: {size} finite numbers)"
        if values.shape != (size,):
            raise InputError(f"the observation has shape {values.shape} {allowed}")
        if not np.isfinite(values).all():
            raise InputError(f"the observation is {values} {allowed}")
        return int(np.argmax(self.logits(values)))


def save_policy(folder: Path, policy: Policy) -> None:
    """Write both files, with the hash in the description updated."""
    data = save(policy.tensors)
    description = msgspec.structs.replace(
        policy.description, sha256=hashlib.sha256(data).hexdigest()
    )
    text = json.dumps(msgspec.to_builtins(description), indent=2)
    atomic_write(folder / "policy.safetensors", data)
    atomic_write(folder / "policy.json", (text + "\n").encode())


def load_policy(folder: Path) -> Policy:
    """Read the policy in a folder.

    Raises InputError, with the name of the file, if a file is missing, damaged or of another
    format version.
    """
    json_file, weights = folder / "policy.json", folder / "policy.safetensors"
    with error_context(str(json_file)):
        text = read_whole(json_file, MAX_BYTES)
        description = decode(text, PolicyDescription, "not a policy description")
        check_plain(description.config)
    if description.format != FORMAT:
        raise InputError(f"{json_file}: format {description.format} (allowed: {FORMAT})")
    with error_context(str(weights)):
        data = read_whole(weights)
    if hashlib.sha256(data).hexdigest() != description.sha256:
        raise InputError(f"{weights}: contents do not match the sha256 in {json_file.name}")
    try:
        tensors = load(data)
    except Exception as error:  # safetensors raises many types of exceptions for damaged files
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
            raise InputError(f"{where}: tensor {name!r} contains a non-finite number")
    actor = tuple(
        (tensors[f"actor.{index}.weights"], tensors[f"actor.{index}.biases"])
        for index in range(len(sizes) - 1)
    )
    if np.any(tensors["normaliser.variance"] < 0.0):
        raise InputError(f"{where}: tensor 'normaliser.variance' contains a negative number")
    if _value_bound(actor, tensors["normaliser.mean"]) > MAX_NETWORK_VALUE:
        raise InputError(f"{where}: its values are so large that the network could overflow")
    count = np.float32(0.0)
    return Policy(
        description,
        actor,
        Normaliser(tensors["normaliser.mean"], tensors["normaliser.variance"], count),
    )


def _value_bound(actor: Layers, mean: Float[np.ndarray, " observation"]) -> float:
    """An upper bound on the magnitude of any value in the forward pass."""
    bound = np.full(len(mean), CLIP)
    greatest = float(np.abs(mean).max(initial=0.0))
    for weights, biases in actor:
        bound = bound @ np.abs(weights.astype(np.float64)) + np.abs(biases.astype(np.float64))
        greatest = max(greatest, float(bound.max(initial=0.0)))
    return greatest


def package_versions() -> dict[str, str]:
    """The versions of the packages that training depends on."""
    versions = {}
    for name in ("skystack", "jax", "jaxlib", "optax", "numpy"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "unknown"
    return versions
