"""The training settings: the tables `[ppo]` and `[pretraining]` of an experiment's TOML."""

from typing import Annotated, Any

import msgspec

Fraction = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
Count = Annotated[int, msgspec.Meta(ge=1, le=1_000_000_000)]
Units = Annotated[int, msgspec.Meta(ge=1, le=4096)]


class Pretraining(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A curriculum: the first part of the training uses other rewards."""

    steps: Annotated[int, msgspec.Meta(ge=0, le=1_000_000_000)] = 500_000
    """The number of steps of pre-training, counted in `ppo.total_steps`; 0 for none."""
    reward: Any = None
    """The rewards of pre-training, of the same type as `task.reward`. None means its defaults."""


class PPOSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Proximal Policy Optimisation. The defaults are the paper's where the paper states a value."""

    total_steps: Annotated[int, msgspec.Meta(ge=1, le=10_000_000_000)] = 2_000_000
    """Environment steps (paper), summed over all environments. The last update may exceed it."""
    learning_rate: Positive = 1e-4
    """Initial learning rate (paper)."""
    gamma: Fraction = 0.99
    """Discount factor (paper)."""
    entropy: NotNegative = 0.01
    """Entropy coefficient (paper)."""
    hidden: tuple[Units, ...] = (64, 64)
    """Units of the hidden layers, with ReLU activations (paper)."""
    final_learning_rate: Fraction = 1.0
    """The final learning rate as a fraction of the initial one; the schedule is linear."""
    gae_lambda: Fraction = 0.95
    clip: Positive = 0.2
    value_coefficient: NotNegative = 0.5
    max_gradient_norm: Positive = 0.5
    adam_epsilon: Positive = 1e-5
    adam_beta2: Fraction = 0.999
    environments: Count = 64
    steps: Count = 128
    """Steps of each environment per update."""
    epochs: Count = 10
    minibatch: Count = 256
    reward_scale: Positive = 0.05
    """Rewards are multiplied by this before learning."""
    normalise_observations: bool = True
    """Whether observations are scaled by their running mean and variance."""
    normalise_advantages: bool = True
    """Whether the advantages of each minibatch are scaled to mean 0 and variance 1."""

    @property
    def samples(self) -> int:
        """Steps of one update, summed over all environments."""
        return self.environments * self.steps

    @property
    def updates(self) -> int:
        """The number of updates that reaches `total_steps`."""
        return -(-self.total_steps // self.samples)
