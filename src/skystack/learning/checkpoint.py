"""Checkpoints: the train state in one safetensors file. Resuming training from it is bit-exact."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from safetensors import safe_open
from safetensors.numpy import save

from skystack.errors import CheckpointError, InputError
from skystack.io.files import atomic_write
from skystack.learning.collection import TrainState
from skystack.learning.monitor import part_not_finite

Leaf = jax.Array | jax.ShapeDtypeStruct


def save_checkpoint(path: Path, train_state: TrainState, fingerprint: str) -> None:
    """Write the train state; `fingerprint` identifies its experiment and seed."""
    leaves = {
        f"{index:03d}": np.asarray(_plain(leaf), order="C")
        for index, leaf in enumerate(jax.tree.leaves(train_state))
    }
    metadata = {"fingerprint": fingerprint, "shapes": _shapes(train_state)}
    atomic_write(path, save(leaves, metadata=metadata))


def load_checkpoint(path: Path, like: TrainState, fingerprint: str) -> TrainState:
    """Read a train state with the structure of `like`, whose leaves may be ShapeDtypeStructs.

    Raises CheckpointError for a damaged file, or a file of another experiment, seed or
    configuration.
    """
    leaves, structure = jax.tree.flatten(like)
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            if metadata.get("fingerprint") != fingerprint or metadata.get("shapes") != _shapes(
                like
            ):
                raise CheckpointError(
                    f"{path}: belongs to another experiment, seed or configuration (allowed: the "
                    "--seed and every --set of the original run; or another folder)"
                )
            loaded = [file.get_tensor(f"{index:03d}") for index in range(len(leaves))]
    except InputError:
        raise
    except Exception as error:  # safetensors and numpy raise many types of exceptions
        raise CheckpointError(f"{path}: not a checkpoint: {error}") from None
    if [_shape(array) for array in loaded] != [_shape(leaf) for leaf in _plain_shapes(like)]:
        raise CheckpointError(
            f"{path}: not a checkpoint: its arrays do not have the shapes in its metadata"
        )
    restored = [_like(old, new) for old, new in zip(leaves, loaded, strict=True)]
    result: TrainState = jax.tree.unflatten(structure, restored)
    part = part_not_finite(result)
    if part is not None:
        raise CheckpointError(f"{path}: damaged: non-finite value in the {part}")
    return result


def _plain(leaf: jax.Array) -> jax.Array:
    return jax.random.key_data(leaf) if _is_key(leaf) else leaf


def _like(old: Leaf, new: np.ndarray) -> jax.Array:
    array = jnp.asarray(new)
    return jax.random.wrap_key_data(array) if _is_key(old) else array


def _is_key(leaf: Leaf) -> bool:
    return bool(jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key))


def _shapes(train_state: TrainState) -> str:
    return json.dumps([_shape(leaf) for leaf in _plain_shapes(train_state)])


def _plain_shapes(train_state: TrainState) -> list[Leaf]:
    leaves = jax.tree.leaves(train_state)
    return [jax.eval_shape(_plain, leaf) if _is_key(leaf) else leaf for leaf in leaves]


def _shape(array: np.ndarray | Leaf) -> list[str | int]:
    return [str(array.dtype), *array.shape]
