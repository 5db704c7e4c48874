"""The progress of a run, as it is reported while training."""

from typing import NamedTuple


class TrainingProgress(NamedTuple):
    """The progress of a run after an update, as `on_update` receives it.

    Example:

        >>> from skystack import TrainingProgress
        >>> progress = TrainingProgress(8192, 2_000_000, 80_000.0, {"success": 0.25})
        >>> f"{progress.steps / progress.total_steps:.1%}"
        '0.4%'
    """

    steps: int
    """The steps so far, including those of earlier runs that this one resumes."""
    total_steps: int
    steps_per_s: float
    """The rate after the first update, which is excluded because it includes compilation."""
    measured: dict[str, float | None]
    """The values of the update's line in `metrics.jsonl`, such as `success` and `entropy`. Metrics
    of scenarios are None if no scenario ended."""
