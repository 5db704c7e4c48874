"""The settings of training: derived sizes, defaults and limits."""

import msgspec
import pytest

from skystack.learning.settings import PPOSettings, Pretraining


def test_updates_cover_the_total_steps():
    def updates(total_steps):
        return PPOSettings(total_steps=total_steps, environments=4, steps=8).updates

    assert PPOSettings(environments=4, steps=8).samples == 32
    assert [updates(total) for total in (1, 31, 32, 33, 64, 65)] == [1, 1, 1, 2, 2, 3]


def test_defaults():
    """The first five values are the paper's."""
    assert msgspec.to_builtins(PPOSettings()) == {
        "total_steps": 2_000_000,
        "learning_rate": 1e-4,
        "gamma": 0.99,
        "entropy": 0.01,
        "hidden": (64, 64),
        "final_learning_rate": 1.0,
        "gae_lambda": 0.95,
        "clip": 0.2,
        "value_coefficient": 0.5,
        "max_gradient_norm": 0.5,
        "adam_epsilon": 1e-5,
        "adam_beta2": 0.999,
        "environments": 64,
        "steps": 128,
        "epochs": 10,
        "minibatch": 256,
        "reward_scale": 0.05,
        "normalise_observations": True,
        "normalise_advantages": True,
    }
    assert Pretraining().steps == 500_000


FRACTIONS = ("gamma", "final_learning_rate", "gae_lambda", "adam_beta2")
NOT_NEGATIVE = ("entropy", "value_coefficient")
POSITIVE = ("learning_rate", "clip", "max_gradient_norm", "adam_epsilon", "reward_scale")
COUNTS = ("environments", "steps", "epochs", "minibatch")
RANGES = {
    **{name: ([0.0, 1.0], [-0.01, 1.01]) for name in FRACTIONS},
    **{name: ([0.0, 1e6], [-0.01, 1_000_001.0]) for name in NOT_NEGATIVE},
    **{name: ([1e-9, 1e6], [0.0, 1_000_001.0]) for name in POSITIVE},
    **{name: ([1, 10**9], [0, 10**9 + 1]) for name in COUNTS},
    "total_steps": ([1, 10**10], [0, 10**10 + 1]),
    "hidden": ([(), (1, 4096)], [(0,), (4097,)]),
}
"""Allowed and rejected values of each setting."""


@pytest.mark.parametrize("name", RANGES)
def test_ranges(name):
    allowed, rejected = RANGES[name]
    for value in allowed:
        assert msgspec.to_builtins(msgspec.convert({name: value}, PPOSettings))[name] == value
    for value in rejected:
        with pytest.raises(msgspec.ValidationError, match=name):
            msgspec.convert({name: value}, PPOSettings)


def test_range_of_pretraining_steps():
    for value in (0, 10**9):
        assert msgspec.convert({"steps": value}, Pretraining).steps == value
    for value in (-1, 10**9 + 1):
        with pytest.raises(msgspec.ValidationError, match="steps"):
            msgspec.convert({"steps": value}, Pretraining)


@pytest.mark.parametrize("kind", [PPOSettings, Pretraining])
def test_rejects_unknown_settings(kind):
    with pytest.raises(msgspec.ValidationError, match="unknown field"):
        msgspec.convert({"surprise": 1}, kind)
