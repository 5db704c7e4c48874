"""Checkpoints from strangers: numbers that are not finite are refused before they are used."""

import jax
import jax.numpy as jnp
import pytest

from skystack.errors import CheckpointError
from skystack.learning.checkpoint import load_checkpoint, save_checkpoint
from skystack.learning.watch import PARTS


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
