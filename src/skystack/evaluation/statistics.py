"""Statistics of the results: means over training runs and scenarios, with bootstrap intervals.

A result is based on two samples: several training runs, and the scenarios that all of them fly. The
bootstrap draws both with replacement. The drawn scenarios are the same for all rows, because all
rows fly the same scenarios. Training runs are drawn separately for each row (the strata). Intervals
are percentiles of the bootstrap distribution. For interquartile means and the probability of
improvement see Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical
Precipice" (2021).
"""

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property

import numpy as np
import pyarrow as pa
from jaxtyping import Float, UInt8
from scipy.stats import trim_mean

from skystack.evaluation.estimate import Estimate

MEASURES = (
    "clearances",
    "instructions",
    "success",
    "correct_exit",
    "excursion",
    "few_clearances",
    "loss_of_separation",
)
"""The columns of the table `episodes` that are reported with an interval."""
RESAMPLES = 2000
MAX_AT_ONCE = 20_000_000
"""The number of draws (resamples times scenarios) processed at once, to bound the memory."""
CONFIDENCE = 0.95
QUARTER = 0.25
"""The share of training runs that an interquartile mean omits at each end."""

Trainings = Float[np.ndarray, "*draws trainings"]
Others = Float[np.ndarray, "*draws others"]
Statistic = Float[np.ndarray, "*draws"] | np.float64


def scores(episodes: Sequence[pa.Table], measure: str) -> Float[np.ndarray, "trainings scenarios"]:
    """A measure for several training runs that flew the same scenarios."""
    return np.stack([table[measure].to_numpy().astype(np.float64) for table in episodes])


def mean(each: Trainings) -> Statistic:
    """The mean over training runs."""
    result: Statistic = each.mean(axis=-1)
    return result


def interquartile_mean(each: Trainings) -> Statistic:
    """The mean over training runs without the lowest and highest quarter, each rounded down."""
    trimmed: Statistic = trim_mean(each, QUARTER, axis=-1)
    return trimmed


def probability_less(first: Trainings, second: Others) -> Statistic:
    """The probability that a training run of `first` has a lower value than one of `second`.

    Ties count half.
    """
    gap = second[..., None, :] - first[..., :, None]
    result: Statistic = (0.5 * (np.sign(gap) + 1.0)).mean(axis=(-2, -1))
    return result


class Bootstrap:
    """Bootstrap resamples of the scenarios 0 to `scenarios` - 1, which every row flies."""

    def __init__(self, scenarios: int, resamples: int = RESAMPLES, seed: int = 0) -> None:
        self.scenarios, self.resamples = scenarios, resamples
        self._random = np.random.default_rng(seed)

    @cached_property
    def _counts(self) -> UInt8[np.ndarray, "resamples scenarios"]:
        """How often each scenario is drawn: a few times, far fewer than 256."""
        uniform = np.full(self.scenarios, 1.0 / self.scenarios)
        counts = np.empty((self.resamples, self.scenarios), dtype=np.uint8)
        for part in self._slices():
            counts[part] = self._random.multinomial(self.scenarios, uniform, size=len(counts[part]))
        return counts

    def _slices(self) -> Iterator[slice]:
        """The resamples in slices of at most `MAX_AT_ONCE` draws."""
        most = max(MAX_AT_ONCE // self.scenarios, 1)
        return (slice(at, at + most) for at in range(0, self.resamples, most))

    def means(self, values: Float[np.ndarray, "trainings scenarios"]) -> Trainings:
        """Means over the drawn scenarios for the drawn training runs, one row per resample."""
        columns, count = values.T.astype(np.float32), np.float32(self.scenarios)
        counts = self._counts
        parts = [(counts[part].astype(np.float32) / count) @ columns for part in self._slices()]
        each = np.concatenate(parts).astype(np.float64)
        drawn = self._random.integers(len(values), size=each.shape)
        return np.take_along_axis(each, drawn, axis=1)

    def estimate(
        self,
        statistic: Callable[..., Statistic],
        *rows: Float[np.ndarray, "_ scenarios"],
    ) -> Estimate:
        """A statistic of the per-training means of one or two rows, with its interval."""
        value = statistic(*(row.mean(axis=1) for row in rows))
        tail = 50.0 * (1.0 - CONFIDENCE)
        drawn = statistic(*(self.means(row) for row in rows))
        low, high = np.percentile(drawn, [tail, 100.0 - tail])
        return Estimate(float(value), float(low), float(high))


def row_statistics(episodes: Sequence[pa.Table]) -> dict[str, dict[str, Estimate]]:
    """Mean and interquartile mean of every measure of a row, with their intervals."""
    bootstrap = Bootstrap(episodes[0].num_rows)
    return {
        measure: {
            "mean": bootstrap.estimate(mean, scores(episodes, measure)),
            "iqm": bootstrap.estimate(interquartile_mean, scores(episodes, measure)),
        }
        for measure in MEASURES
    }


def comparison(
    first: Sequence[pa.Table], second: Sequence[pa.Table], measure: str
) -> dict[str, Estimate]:
    """How the first row differs from the second in a measure, on the same scenarios."""
    bootstrap = Bootstrap(first[0].num_rows)
    values = scores(first, measure), scores(second, measure)
    return {
        "difference": bootstrap.estimate(lambda one, two: mean(one) - mean(two), *values),
        "probability_less": bootstrap.estimate(probability_less, *values),
    }
