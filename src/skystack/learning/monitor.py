"""Detection of non-finite values and exploding losses in training, before they are saved."""

from pathlib import Path

import jax
import numpy as np

from skystack.errors import TrainingError
from skystack.learning.collection import TrainState

MAX_LOSS = 1e6
"""A larger loss counts as exploded. Rewards are scaled to about 1, so with a discount of 0.99 a
return is at most about 100 and half its square 5,000. The limit is 200 times that: such a loss is
not noise, and training rarely recovers from it."""

LOSSES = ("policy_loss", "value_loss", "entropy")
PARTS = ("parameters", "optimiser", "normaliser", "observations", "returns")
"""The parts of a train state that must be finite. `scenarios` may contain an infinite distance,
which means that there was none so far."""


class TrainingMonitor:
    """Checks the values of one training run, and reports its last good checkpoint."""

    def __init__(self, experiment: str, seed: int, checkpoint: Path, saved_steps: int) -> None:
        self._name = f"{experiment}, seed {seed}"
        self._checkpoint, self.saved_steps = checkpoint, saved_steps

    def check(self, train_state: TrainState, values: dict[str, float | None], steps: int) -> None:
        """Check an update. Raises TrainingError that states the first invalid term and `steps`."""
        for term in LOSSES:
            value = values[term]
            if value is None:
                raise self._error(f"{term} is not finite", steps)
            if abs(value) > MAX_LOSS:
                raise self._error(
                    f"{term} has exploded: {value:.3g} (allowed: up to {MAX_LOSS:.0e}; "
                    "a lower ppo.learning_rate or ppo.reward_scale may help)",
                    steps,
                )
        part = part_not_finite(train_state)
        if part is not None:
            raise self._error(f"non-finite value in the {part}", steps)

    def _error(self, problem: str, steps: int) -> TrainingError:
        good = f"{self._checkpoint}, after {self.saved_steps} steps" if self.saved_steps else "none"
        return TrainingError(
            f"{self._name}: {problem} after {steps} steps; last good checkpoint: {good}"
        )


def part_not_finite(train_state: TrainState) -> str | None:
    """The first part of a train state with a non-finite value; None if all values are finite."""
    for part in PARTS:
        if not all(map(_is_finite, jax.tree.leaves(getattr(train_state, part)))):
            return part
    return None


def _is_finite(leaf: jax.Array) -> bool:
    return bool(np.all(np.isfinite(np.asarray(leaf))))
