"""The numbers of a training, watched: what is not finite or explodes is named, and not saved."""

import math
from pathlib import Path
from typing import Any

import jax
import numpy as np

from skystack.errors import TrainingError
from skystack.learning.ppo import TrainState

LARGEST_LOSS = 1e6
"""Rewards are scaled to about unit size, and discounted at 0.99 a return is a hundred of them: half
its square is 5,000. A loss two hundred times that is no noise, and weights seldom come back."""

LOSSES = ("policy_loss", "value_loss", "entropy")
PARTS = ("parameters", "optimiser", "normaliser", "observations", "returns")
"""Of a learner: all that must be finite. Scenarios may hold an infinite distance: none so far."""


class TrainingMonitor:
    """One training's numbers, and where its last good checkpoint is."""

    def __init__(self, experiment: str, seed: int, checkpoint: Path, saved_steps: int) -> None:
        self._name = f"{experiment}, seed {seed}"
        self._checkpoint, self.saved_steps = checkpoint, saved_steps

    def check(self, learner: TrainState, values: dict[str, float | None], steps: int) -> None:
        """Raises TrainingError that names the first term that is wrong after so many steps."""
        for term in LOSSES:
            value = values[term]
            if value is None:
                raise self._error(f"{term} is not finite", steps)
            if abs(value) > LARGEST_LOSS:
                raise self._error(
                    f"{term} has exploded: {value:.3g} (allowed: up to {LARGEST_LOSS:.0e}; "
                    "a lower ppo.learning_rate or ppo.reward_scale may help)",
                    steps,
                )
        part = part_not_finite(learner)
        if part is not None:
            raise self._error(f"the learner's {part} are not finite", steps)

    def _error(self, what: str, steps: int) -> TrainingError:
        good = f"{self._checkpoint}, after {self.saved_steps} steps" if self.saved_steps else "none"
        return TrainingError(
            f"{self._name}: {what} after {steps} steps; last good checkpoint: {good}"
        )


def part_not_finite(learner: TrainState) -> str | None:
    """The first part of a learner with a number that is not finite; None where all are."""
    for part in PARTS:
        if not all(map(_is_finite, jax.tree.leaves(getattr(learner, part)))):
            return part
    return None


def finite(value: Any) -> float | None:
    """JSON has no NaN: what was not measured (no scenario ended) is null."""
    number = float(value)
    return number if math.isfinite(number) else None


def _is_finite(leaf: jax.Array) -> bool:
    return bool(np.all(np.isfinite(np.asarray(leaf))))
