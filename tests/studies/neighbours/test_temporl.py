"""The replay memory of TempoRL against brute force."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from studies.neighbours import temporl
from studies.neighbours.temporl import CYCLES, REPLAY_CYCLES, Replay, sample_runs

GAMMA = 0.9
ENVIRONMENTS = 3


def filled_replay(rng):
    """Repetitions of random lengths; the observation is (cycle, environment)."""
    shape = (REPLAY_CYCLES, ENVIRONMENTS)
    cycle, environment = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij")
    ended = rng.uniform(size=shape) < 0.05
    remaining, action = np.zeros(shape, dtype=np.int32), np.zeros(shape, dtype=np.int32)
    left = np.zeros(ENVIRONMENTS, dtype=np.int32)
    held = np.zeros(ENVIRONMENTS, dtype=np.int32)
    for index in range(shape[0]):
        new = left == 0
        left = np.where(new, rng.integers(0, temporl.MOST, ENVIRONMENTS), left - 1)
        held = np.where(new, rng.integers(0, 5, ENVIRONMENTS), held)
        left = np.where(ended[index], 0, left)
        remaining[index], action[index] = left, held
    observation = np.stack([cycle, environment], axis=-1).astype(np.float32)
    reward = rng.normal(size=shape).astype(np.float32)
    return Replay(
        observation,
        action,
        reward,
        ended,
        remaining,
        observation + np.array([1.0, 0.0], dtype=np.float32),
    )


@pytest.mark.slow
def test_runs_stay_inside_repetitions():
    replay = filled_replay(np.random.default_rng(0))
    filled = 10 * CYCLES
    traced = jax.tree.map(jnp.asarray, replay)
    runs = jax.device_get(sample_runs(traced, jnp.asarray(filled), GAMMA, 5000, jax.random.key(0)))
    lengths = set()
    for index in range(5000):
        first, environment = runs.observation[index].astype(int)
        cycles = int(runs.cycles[index])
        assert first < filled
        inside = slice(first, first + cycles)
        rewards = replay.reward[inside, environment]
        assert runs.reward[index] == pytest.approx(
            float(np.sum(GAMMA ** np.arange(cycles) * rewards)), abs=1e-5
        )
        assert set(replay.action[inside, environment]) == {runs.action[index]}
        # Only the last cycle may end the scenario or the repetition.
        assert not replay.ended[inside, environment][:-1].any()
        assert (replay.remaining[inside, environment][:-1] > 0).all()
        assert first // CYCLES == (first + cycles - 1) // CYCLES
        ended = replay.ended[first + cycles - 1, environment]
        assert runs.discount[index] == pytest.approx(0.0 if ended else GAMMA**cycles, rel=1e-5)
        assert tuple(runs.following[index]) == (first + cycles, environment)
        lengths.add(cycles)
    assert lengths == set(range(1, temporl.MOST + 1))
