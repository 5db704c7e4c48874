"""Policies of Stable-Baselines3 (`model.save`), read without executing code from the file.

The zip contains pickles, which `PPO.load` executes. Here they are ignored: the description is read
as JSON and the weights as plain tensors, and the network, whose form is fixed, is rebuilt in numpy.
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
MAX_DESCRIPTION = 16_000_000
MAX_PARTS = 1000
"""The maximum number of files in a zip."""
SAFE_TORCH = (2, 6)
"""The first version in which `weights_only=True` cannot be bypassed (CVE-2025-32434)."""
Layer = tuple[np.ndarray, np.ndarray]
"""Weights `[outputs, inputs]` and biases `[outputs]`."""

_POLICIES = {
    "stable_baselines3.common.policies": ("Tanh", "mlp_extractor.policy_net.", "action_net."),
    "stable_baselines3.dqn.policies": ("ReLU", "q_net.q_net.", None),
}
"""By the policy's module: the default activation, the prefix of the layers' tensors, and the prefix
of the output layer if it is separate."""
_TENSORS = ("mlp_extractor.", "action_net.", "value_net.", "q_net.", "q_net_target.")
"""The prefixes of all tensors that such policies have."""
_SETTINGS = {
    "activation_fn",
    "net_arch",
    "normalize_images",
    "optimizer_class",
    "optimizer_kwargs",
    "ortho_init",
    "share_features_extractor",
}
"""The accepted policy settings: without effect on the output, or read here or from the tensors."""


@dataclass(frozen=True)
class Network:
    """A fully-connected network as built by Stable-Baselines3."""

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

    Its deterministic action is that of the largest output. Nothing in the file is executed. Raises
    InputError for a file that is missing, damaged or of another kind, and if PyTorch is missing or
    older than 2.6.
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
    """The description and the weights file."""
    with _zip(data) as file:
        names = file.namelist()
        missing = [name for name in ("data", "policy.pth") if names.count(name) != 1]
        if missing:
            raise InputError(f"does not have exactly one part {missing[0]!r} ({ALLOWED})")
        text = _read(file, "data", MAX_DESCRIPTION)
        weights = _read(file, "policy.pth", MOST_BYTES)
    try:
        description = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"its part 'data' is not JSON ({error})") from None
    if not isinstance(description, dict):
        raise InputError(f"its part 'data' is not a JSON object ({ALLOWED})")
    return description, weights


def _zip(data: bytes) -> zipfile.ZipFile:
    try:
        file = zipfile.ZipFile(io.BytesIO(data))
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        raise InputError(f"is not a zip ({error}; {ALLOWED})") from None
    if len(file.infolist()) > MAX_PARTS:
        raise InputError(f"has {len(file.infolist())} parts (allowed: {MAX_PARTS})")
    return file


def _read(
    file: zipfile.ZipFile, name: str | zipfile.ZipInfo, most_bytes: int, allowed: str = ""
) -> bytes:
    """Read a part of at most `most_bytes`, whatever size it claims to have.

    `allowed` is the limit in words, by default `most_bytes` itself.
    """
    try:
        with file.open(name) as part:
            data = part.read(most_bytes + 1)
    except (zipfile.BadZipFile, zlib.error, OSError, RuntimeError, ValueError, EOFError) as error:
        raise InputError(f"its part {_named(name)} cannot be read ({error})") from None
    if len(data) > most_bytes:
        allowed = allowed or _megabytes(most_bytes)
        raise InputError(f"its part {_named(name)} is too large (allowed: {allowed})")
    return data


def _megabytes(count: int) -> str:
    return f"{count // 10**6} MB"


def _named(part: str | zipfile.ZipInfo) -> str:
    return repr(part if isinstance(part, str) else part.filename)


def _kind(description: Mapping[str, Any]) -> tuple[str, str]:
    """The policy's module and its activation, from their names in the description."""
    policy, settings = (_table(description, name) for name in ("policy_class", "policy_kwargs"))
    module = policy.get("__module__")
    if not isinstance(module, str) or module not in _POLICIES:
        raise InputError(f"its policy class is from {module!r} ({ALLOWED})")
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
        raise InputError(f"{path} needs torch 2.6 or newer, installed is {torch.__version__}")
    return torch


def _tensors(torch: Any, data: bytes) -> dict[str, np.ndarray]:
    """The weights by name. They are in a zip too, whose size is checked before PyTorch reads it."""
    with _zip(data) as file:
        remaining, allowed = MOST_BYTES, f"{_megabytes(MOST_BYTES)} in all"
        for part in file.infolist():
            remaining -= len(_read(file, part, remaining, allowed))
    try:
        found = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # PyTorch has many exceptions for damaged files
        raise InputError(f"its part 'policy.pth' is damaged: {error}") from None
    if not isinstance(found, dict) or not all(
        isinstance(name, str) and isinstance(tensor, torch.Tensor) for name, tensor in found.items()
    ):
        raise InputError(f"its part 'policy.pth' holds more than tensors ({ALLOWED})")
    tensors = {}
    for name, tensor in found.items():
        if not name.startswith(_TENSORS):
            raise InputError(f"has an unexpected tensor {name!r} ({ALLOWED})")
        plain = tensor.layout is torch.strided and tensor.is_contiguous()
        if not plain or tensor.dtype is not torch.float32 or tensor.device.type != "cpu":
            raise InputError(f"tensor {name!r} is {tensor.dtype} (allowed: dense float32)")
        tensors[name] = tensor.detach().resolve_neg().numpy()
        if not np.all(np.isfinite(tensors[name])):
            raise InputError(f"tensor {name!r} holds a non-finite number")
    return tensors


def _layers(tensors: Mapping[str, np.ndarray], hidden: str, last: str | None) -> tuple[Layer, ...]:
    """The layers in order; the odd indices are activations."""
    pattern = re.compile(re.escape(hidden) + r"(\d{1,3})\.weight")
    numbers = sorted(int(found[1]) for name in tensors if (found := pattern.fullmatch(name)))
    if numbers != list(range(0, 2 * len(numbers), 2)):
        raise InputError(f"its layers are {hidden}{numbers} ({ALLOWED})")
    prefixes = [f"{hidden}{number}." for number in numbers] + [last] * (last is not None)
    layers: list[Layer] = []
    for prefix in prefixes:
        weights, biases = (tensors.get(f"{prefix}{part}") for part in ("weight", "bias"))
        inputs = layers[-1][1].size if layers else None
        fits = (
            weights is not None
            and biases is not None
            and weights.ndim == 2
            and biases.shape == weights.shape[:1]
            and inputs in (None, weights.shape[1])
        )
        if not fits:
            raise InputError(f"tensors {prefix}weight and .bias do not fit ({ALLOWED})")
        layers.append((weights, biases))  # type: ignore[arg-type]
    if not layers:
        raise InputError(f"has no tensors {hidden}* ({ALLOWED})")
    return tuple(layers)


def _sizes(description: Mapping[str, Any], layers: tuple[Layer, ...]) -> tuple[int, int]:
    """The numbers of observed values and of actions, which must match the two spaces."""
    spaces = [_table(description, f"{name}_space") for name in ("observation", "action")]
    sizes = layers[0][0].shape[1], layers[-1][0].shape[0]
    kinds = [str(space.get(":type:")) for space in spaces]
    shape = re.findall(r"\d+", str(spaces[0].get("_shape")))
    if "spaces.box.Box" not in kinds[0] or shape != [str(sizes[0])]:
        raise InputError(f"its observation space is {kinds[0]} {shape} (allowed: a flat Box)")
    count, start = (str(spaces[1].get(name, 0)) for name in ("n", "start"))
    if "spaces.discrete.Discrete" not in kinds[1] or (count, start) != (str(sizes[1]), "0"):
        raise InputError(f"its action space is {kinds[1]}, n {count}, start {start} ({ALLOWED})")
    return sizes
