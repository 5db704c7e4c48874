"""Checkpoints: what was saved comes back, and nothing else is believed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from skystack.errors import CheckpointError
from skystack.learning.checkpoint import load_checkpoint, save_checkpoint
from skystack.learning.monitor import PARTS


@pytest.mark.parametrize("value", [jnp.nan, jnp.inf])
@pytest.mark.parametrize("part", PARTS)
def test_a_number_that_is_not_finite_is_refused(part, value, learner, tmp_path):
    leaves, structure = jax.tree.flatten(getattr(learner, part))
    place = next(
        index
        for index, leaf in enumerate(leaves)
        if leaf.size and jnp.issubdtype(leaf.dtype, jnp.floating)
    )
    leaves[place] = leaves[place].at[(0,) * leaves[place].ndim].set(value)
    damaged = learner._replace(**{part: jax.tree.unflatten(structure, leaves)})
    save_checkpoint(tmp_path / "learner.safetensors", damaged, "ours")
    with pytest.raises(CheckpointError, match=f"the learner's {part} are not finite"):
        load_checkpoint(tmp_path / "learner.safetensors", learner, "ours")


def plain(leaf):
    is_key = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
    return np.asarray(jax.random.key_data(leaf) if is_key else leaf)


def test_a_learner_survives_the_disk_bit_for_bit(learner, tmp_path):
    path = tmp_path / "learner.safetensors"
    save_checkpoint(path, learner, "ours")
    shapes = jax.eval_shape(lambda: learner)
    for like in (learner, shapes):
        loaded = load_checkpoint(path, like, "ours")
        assert jax.tree.structure(loaded) == jax.tree.structure(learner)
        for ours, theirs in zip(*map(jax.tree.leaves, (loaded, learner)), strict=True):
            assert ours.dtype == theirs.dtype
            assert plain(ours).tobytes() == plain(theirs).tobytes()
    assert jax.random.uniform(loaded.key) == jax.random.uniform(learner.key)


def test_another_trainings_checkpoint_is_refused(learner, tmp_path):
    path = tmp_path / "learner.safetensors"
    save_checkpoint(path, learner, "theirs")
    with pytest.raises(CheckpointError, match="belongs to another experiment"):
        load_checkpoint(path, learner, "ours")
    save_checkpoint(path, learner._replace(returns=jnp.zeros(3)), "ours")
    with pytest.raises(CheckpointError, match="belongs to another experiment"):
        load_checkpoint(path, learner, "ours")


def test_arrays_of_other_shapes_than_stated_are_refused(learner, tmp_path):
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
