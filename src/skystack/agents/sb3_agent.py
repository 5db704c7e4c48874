"""Policies of Stable-Baselines3 (`model.save`), read without running what is in the file.

Such a zip holds pickles, which `PPO.load` executes. Here its description is read as JSON without
them, the weights as plain tensors, and the network, always the same, is rebuilt in numpy.
"""

import io
import json
import re
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from skystack.agents.agent import Agent, file_name
from skystack.errors import InputError, error_context, missing_extra
from skystack.io.files import MOST_BYTES, read_whole

ALLOWED = "allowed: PPO, A2C, DQN of Stable-Baselines3 with MlpPolicy and Discrete actions"
MOST_DESCRIPTION = 16_000_000
MOST_PARTS = 1000
"""Of a zip."""
SAFE_TORCH = (2, 6)
"""Before it `weights_only=True` could be bypassed (CVE-2025-32434)."""
Layer = tuple[np.ndarray, np.ndarray]
"""Weights, outputs by inputs, and biases."""

_POLICIES = {
    "stable_baselines3.common.policies": ("Tanh", "mlp_extractor.policy_net.", "action_net."),
    "stable_baselines3.dqn.policies": ("ReLU", "q_net.q_net.", None),
}
"""By the policy's module: its activation unless another is named, the names of its layers' tensors,
and of those of the last one where it is apart."""
_TENSORS = ("mlp_extractor.", "action_net.", "value_net.", "q_net.", "q_net_target.")
"""All that such policies have."""
_SETTINGS = {
    "activation_fn",
    "net_arch",
    "normalize_images",
    "optimizer_class",
    "optimizer_kwargs",
    "ortho_init",
    "share_features_extractor",
}
"""Of a policy: those that do not change its answers, or are read here or from the tensors."""


@dataclass(frozen=True)
class Network:
    """A fully-connected network as Stable-Baselines3 makes them."""

    layers: tuple[Layer, ...]
    activation: str

    def __call__(
        self, observations: Float[np.ndarray, "*scenarios observation"]
    ) -> Float[np.ndarray, "*scenarios actions"]:
        value = observations
        for index, (weights, biases) in enumerate(self.layers):
            value = value @ weights.T + biases
            if index < len(self.layers) - 1:
                value = np.tanh(value) if self.activation == "Tanh" else np.maximum(value, 0.0)
        return value


def read_sb3(path: Path) -> Agent:
    """The policy in a zip of Stable-Baselines3: PPO, A2C or DQN with `MlpPolicy`.

    Its deterministic answer is the action of the greatest output. Nothing in the file is executed.
    Raises InputError for a file that is missing, damaged or of another kind, and where PyTorch is
    missing or older than 2.6.
    """
    with error_context(str(path)):
        description, weights = _parts(read_whole(path))
        module, activation = _kind(description)
    torch = _torch(str(path))
    with error_context(str(path)):
        _, hidden, last = _POLICIES[module]
        network = Network(_layers(_tensors(torch, weights), hidden, last), activation)
        observations, actions = _sizes(description, network.layers)
    return Agent(
        file_name(path),
        scores=network,
        logits=last is not None,
        observations=observations,
        actions=actions,
    )


def _parts(data: bytes) -> tuple[Mapping[str, Any], bytes]:
    """The description and the file of weights."""
    with _zip(data) as file:
        names = file.namelist()
        missing = [name for name in ("data", "policy.pth") if names.count(name) != 1]
        if missing:
            raise InputError(f"has no part {missing[0]!r}, or several ({ALLOWED})")
        text = _read(file, "data", MOST_DESCRIPTION)
        weights = _read(file, "policy.pth", MOST_BYTES)
    try:
        description = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"its part 'data' is not JSON ({error})") from None
    if not isinstance(description, dict):
        raise InputError(f"its part 'data' is no JSON object ({ALLOWED})")
    return description, weights


def _zip(data: bytes) -> zipfile.ZipFile:
    try:
        file = zipfile.ZipFile(io.BytesIO(data))
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        raise InputError(f"is not a zip ({error}; {ALLOWED})") from None
    if len(file.infolist()) > MOST_PARTS:
        raise InputError(f"has {len(file.infolist())} parts (allowed: {MOST_PARTS})")
    return file


def _read(file: zipfile.ZipFile, name: str | zipfile.ZipInfo, most_bytes: int) -> bytes:
    """A part of at most so many bytes, whatever size it claims."""
    try:
        with file.open(name) as part:
            data = part.read(most_bytes + 1)
    except (zipfile.BadZipFile, zlib.error, OSError, RuntimeError, ValueError, EOFError) as error:
        raise InputError(f"its part {_named(name)} cannot be read ({error})") from None
    if len(data) > most_bytes:
        most = MOST_BYTES // 10**6
        raise InputError(f"its part {_named(name)} is too large (allowed: {most} MB in all)")
    return data


def _named(part: str | zipfile.ZipInfo) -> str:
    return repr(part if isinstance(part, str) else part.filename)


def _kind(description: Mapping[str, Any]) -> tuple[str, str]:
    """The policy's module and its activation, from what is readable of both."""
    policy, settings = (_table(description, name) for name in ("policy_class", "policy_kwargs"))
    module = policy.get("__module__")
    if not isinstance(module, str) or module not in _POLICIES:
        raise InputError(f"its policy is of {module!r} ({ALLOWED})")
    names = {name for name in settings if not name.startswith(":")}
    if names - _SETTINGS:
        raise InputError(
            f"its policy_kwargs have {', '.join(sorted(names - _SETTINGS))} "
            f"(allowed: {', '.join(sorted(_SETTINGS))})"
        )
    found = str(settings.get("activation_fn", _POLICIES[module][0]))
    activation = re.fullmatch(r"(?:<class 'torch\.nn\.modules\.activation\.)?(\w+)(?:'>)?", found)
    if activation is None or activation[1] not in ("Tanh", "ReLU"):
        raise InputError(f"its activation_fn is {found} (allowed: Tanh, ReLU)")
    return module, activation[1]


def _table(description: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = description.get(name)
    if not isinstance(found, dict):
        raise InputError(f"its {name} is missing ({ALLOWED})")
    return found


def _torch(path: str) -> Any:
    try:
        import torch  # noqa: PLC0415
    except ImportError:
        raise missing_extra(path, "torch", "sb3") from None
    if tuple(int(part) for part in torch.__version__.split(".")[:2]) < SAFE_TORCH:
        raise InputError(f"{path} needs torch 2.6 or newer, here is {torch.__version__}")
    return torch


def _tensors(torch: Any, data: bytes) -> dict[str, np.ndarray]:
    """The weights by name. They are a zip too, whose parts are looked at before PyTorch does."""
    with _zip(data) as file:
        left = MOST_BYTES
        for part in file.infolist():
            left -= len(_read(file, part, left))
    try:
        found = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # PyTorch raises its own kinds for each kind of damage
        raise InputError(f"its part 'policy.pth' is damaged: {error}") from None
    if not isinstance(found, dict) or not all(
        isinstance(name, str) and isinstance(tensor, torch.Tensor) for name, tensor in found.items()
    ):
        raise InputError(f"its part 'policy.pth' holds more than tensors ({ALLOWED})")
    tensors = {}
    for name, tensor in found.items():
        if not name.startswith(_TENSORS):
            raise InputError(f"has the tensor {name!r} ({ALLOWED})")
        plain = tensor.layout is torch.strided and tensor.is_contiguous()
        if not plain or tensor.dtype is not torch.float32 or tensor.device.type != "cpu":
            raise InputError(f"tensor {name!r} is {tensor.dtype} (allowed: dense float32)")
        tensors[name] = tensor.detach().resolve_neg().numpy()
        if not np.all(np.isfinite(tensors[name])):
            raise InputError(f"tensor {name!r} holds a non-finite number")
    return tensors


def _layers(tensors: Mapping[str, np.ndarray], hidden: str, last: str | None) -> tuple[Layer, ...]:
    """In order; the numbers between theirs are activations."""
    pattern = re.compile(re.escape(hidden) + r"(\d{1,3})\.weight")
    numbers = sorted(int(found[1]) for name in tensors if (found := pattern.fullmatch(name)))
    if numbers != list(range(0, 2 * len(numbers), 2)):
        raise InputError(f"its layers are {hidden}{numbers} ({ALLOWED})")
    stems = [f"{hidden}{number}." for number in numbers] + [last] * (last is not None)
    layers: list[Layer] = []
    for stem in stems:
        weights, biases = (tensors.get(f"{stem}{part}") for part in ("weight", "bias"))
        inputs = layers[-1][1].size if layers else None
        fits = (
            weights is not None
            and biases is not None
            and weights.ndim == 2
            and biases.shape == weights.shape[:1]
            and inputs in (None, weights.shape[1])
        )
        if not fits:
            raise InputError(f"tensors {stem}weight and .bias do not fit ({ALLOWED})")
        layers.append((weights, biases))  # type: ignore[arg-type]
    if not layers:
        raise InputError(f"has no tensors {hidden}* ({ALLOWED})")
    return tuple(layers)


def _sizes(description: Mapping[str, Any], layers: tuple[Layer, ...]) -> tuple[int, int]:
    """How many values are observed and how many actions there are; both spaces must say so."""
    observed, acted = (_table(description, f"{name}_space") for name in ("observation", "action"))
    sizes = layers[0][0].shape[1], layers[-1][0].shape[0]
    kinds = [str(space.get(":type:")) for space in (observed, acted)]
    shape = re.findall(r"\d+", str(observed.get("_shape")))
    if "spaces.box.Box" not in kinds[0] or shape != [str(sizes[0])]:
        raise InputError(f"its observation space is {kinds[0]} {shape} (allowed: a flat Box)")
    count, start = (str(acted.get(name, 0)) for name in ("n", "start"))
    if "spaces.discrete.Discrete" not in kinds[1] or (count, start) != (str(sizes[1]), "0"):
        raise InputError(f"its action space is {kinds[1]}, n {count}, start {start} ({ALLOWED})")
    return sizes
