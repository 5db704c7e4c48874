"""The learner's settings: `[ppo]` and `[pretraining]` of an experiment's TOML. Data only."""

from typing import Annotated

import msgspec

from skystack.tasks.settings import RewardSettings

Fraction = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
Count = Annotated[int, msgspec.Meta(ge=1, le=1_000_000_000)]


class Pretraining(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A curriculum: the first part of the training with other rewards."""

    steps: Annotated[int, msgspec.Meta(ge=0, le=1_000_000_000)] = 500_000
    """The first so many of `ppo.total_steps`; 0: none."""
    reward: RewardSettings = RewardSettings()


class PPOSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Proximal Policy Optimisation; the defaults are the paper's where the paper says."""

    total_steps: Annotated[int, msgspec.Meta(ge=1, le=10_000_000_000)] = 2_000_000
    """Paper. Steps of one scenario; the last update may go beyond by a part of itself."""
    learning_rate: Positive = 1e-4
    """Paper."""
    gamma: Fraction = 0.99
    """Paper."""
    entropy: NotNegative = 0.01
    """Paper: the entropy coefficient."""
    hidden: tuple[Count, ...] = (64, 64)
    """Paper: units of the hidden layers, with ReLU between."""
    final_learning_rate: Fraction = 1.0
    """What is left of the learning rate at the end, as a fraction; linear in between."""
    gae_lambda: Fraction = 0.95
    clip: Positive = 0.2
    value_coefficient: NotNegative = 0.5
    max_gradient_norm: Positive = 0.5
    adam_epsilon: Positive = 1e-5
    adam_beta2: Fraction = 0.999
    environments: Count = 64
    steps: Count = 128
    """Of each environment in an update."""
    epochs: Count = 10
    minibatch: Count = 256
    reward_scale: Positive = 0.05
    """Rewards are multiplied by this before learning."""

    @property
    def samples(self) -> int:
        """Steps of one update, all environments together."""
        return self.environments * self.steps

    @property
    def updates(self) -> int:
        """As many as it takes to reach `total_steps`."""
        return -(-self.total_steps // self.samples)
