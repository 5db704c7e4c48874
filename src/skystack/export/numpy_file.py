"""A policy as one `.npz` file with its tensors and names; a few lines of numpy evaluate it."""

import io
from pathlib import Path

import numpy as np

from skystack.io.files import atomic_write
from skystack.learning.policy import Policy
from skystack.policies.facts import facts


def export_numpy(policy: Policy, output: Path) -> None:
    """Write the policy so that `np.load` reads it without pickle; see docs/formats.md.

    Raises InputError if the file cannot be written.
    """
    arrays = {name: np.asarray(value) for name, value in facts(policy).items()}
    data = io.BytesIO()
    np.savez(data, allow_pickle=False, **policy.tensors, **arrays)
    atomic_write(output, data.getvalue())
