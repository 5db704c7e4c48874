"""Checkpoints load exactly as saved, and damaged or foreign ones are rejected."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from skystack.errors import CheckpointError
from skystack.learning.checkpoint import load_checkpoint, save_checkpoint
from skystack.learning.monitor import PARTS


@pytest.mark.slow
@pytest.mark.parametrize("value", [jnp.nan, jnp.inf])
@pytest.mark.parametrize("part", PARTS)
def test_rejects_a_non_finite_value(part, value, learner, tmp_path):
    leaves, structure = jax.tree.flatten(getattr(learner, part))
    index = next(
        index
        for index, leaf in enumerate(leaves)
        if leaf.size and jnp.issubdtype(leaf.dtype, jnp.floating)
    )
    leaves[index] = leaves[index].at[(0,) * leaves[index].ndim].set(value)
    damaged = learner._replace(**{part: jax.tree.unflatten(structure, leaves)})
    save_checkpoint(tmp_path / "learner.safetensors", damaged, "ours")
    with pytest.raises(CheckpointError, match=f"non-finite value in the {part}$"):
        load_checkpoint(tmp_path / "learner.safetensors", learner, "ours")


def raw(leaf):
    """A leaf as a NumPy array; random keys as their data."""
    is_key = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(leaf) if is_key else leaf)


@pytest.mark.slow
def test_round_trip_is_bit_identical(learner, tmp_path):
    path = tmp_path / "learner.safetensors"
    save_checkpoint(path, learner, "ours")
    shapes = jax.eval_shape(lambda: learner)
    for like in (learner, shapes):
        loaded = load_checkpoint(path, like, "ours")
        assert jax.tree.structure(loaded) == jax.tree.structure(learner)
        for ours, theirs in zip(*map(jax.tree.leaves, (loaded, learner)), strict=True):
            assert ours.dtype == theirs.dtype
            assert raw(ours).tobytes() == raw(theirs).tobytes()
    assert jax.random.uniform(loaded.key) == jax.random.uniform(learner.key)


def test_rejects_a_checkpoint_of_another_experiment(learner, tmp_path):
    path = tmp_path / "learner.safetensors"
    save_checkpoint(path, learner, "theirs")
    with pytest.raises(CheckpointError, match="belongs to another experiment"):
        load_checkpoint(path, learner, "ours")
    save_checkpoint(path, learner._replace(returns=jnp.zeros(3)), "ours")
    with pytest.raises(CheckpointError, match="belongs to another experiment"):
        load_checkpoint(path, learner, "ours")


def test_rejects_arrays_of_unexpected_shapes(learner, tmp_path):
    path = tmp_path / "learner.safetensors"
    save_checkpoint(path, learner, "ours")
    with safe_open(path, framework="numpy") as file:
        metadata = file.metadata()
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    save_file(arrays | {"000": arrays["000"][:-1]}, path, metadata)
    with pytest.raises(
        CheckpointError, match="not a checkpoint: its arrays do not have the shapes"
    ):
        load_checkpoint(path, learner, "ours")
    save_file(arrays | {"000": np.append(arrays["000"], arrays["000"], axis=0)}, path, metadata)
    with pytest.raises(
        CheckpointError, match="not a checkpoint: its arrays do not have the shapes"
    ):
        load_checkpoint(path, learner, "ours")
    save_file({name: arrays[name] for name in arrays if name != "000"}, path, metadata)
    with pytest.raises(CheckpointError, match="not a checkpoint"):
        load_checkpoint(path, learner, "ours")
    path.write_bytes(b"{}")
    with pytest.raises(CheckpointError, match="not a checkpoint"):
        load_checkpoint(path, learner, "ours")
