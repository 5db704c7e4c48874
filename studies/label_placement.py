"""Compare skystack's label placement with adjustText on the same flights.

    python -m studies.label_placement EVALUATION [--scenarios N]

Draws the first scenarios of an evaluation with both and counts overlapping labels, hidden points of
the drawing and labels outside the axes. Needs the package adjustText, which is not a dependency.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from skystack.reporting import trajectories
from skystack.reporting.flights import read_scenario
from skystack.reporting.labels import Label, place_labels
from skystack.reporting.style import house_style

Place = Callable[[Axes, Sequence[Label], Any], None]
TIME_LIMIT_S = 5.0
"""The time limit of adjustText for one picture."""


@dataclass
class Tally:
    """The results of one method over all pictures."""

    labels: int = 0
    overlapping: int = 0
    hidden: int = 0
    outside: int = 0
    wall_s: float = 0.0


def adjusted(axes: Axes, labels: Sequence[Label], drawn: Float[np.ndarray, "points 2"]) -> None:
    """Place labels with adjustText."""
    texts = [
        axes.text(*label.point, label.text, fontsize=label.size_pt, fontweight=label.weight)
        for label in labels
    ]
    np.random.seed(0)  # noqa: NPY002  (adjustText uses this generator)
    import_module("adjustText").adjust_text(
        texts, x=drawn[:, 0], y=drawn[:, 1], ax=axes, time_lim=TIME_LIMIT_S, ensure_inside_axes=True
    )


def counted(place: Place, tally: Tally) -> Place:
    """The method, extended to add its results to the tally."""

    def run(axes: Axes, labels: Sequence[Label], drawn: Any) -> None:
        others, started = set(axes.texts), time.monotonic()
        place(axes, labels, drawn)
        tally.wall_s += time.monotonic() - started
        axes.figure.canvas.draw()
        texts = [text for text in axes.texts if text not in others and text.get_text()]
        boxes = np.array([text.get_window_extent().get_points() for text in texts])
        points = axes.transData.transform(drawn)[:, None]
        low, high = axes.get_window_extent().get_points()
        apart = (boxes[:, None, 0] > boxes[None, :, 1]) | (boxes[:, None, 1] < boxes[None, :, 0])
        within = np.all((points > boxes[None, :, 0]) & (points < boxes[None, :, 1]), axis=-1)
        tally.labels += len(texts)
        tally.overlapping += int(np.triu(~np.any(apart, axis=-1), k=1).sum())
        tally.hidden += int(within.sum())
        tally.outside += int(np.any((boxes[:, 0] < low) | (boxes[:, 1] > high), axis=1).sum())

    return run


def main() -> int:
    """Print one line for each method."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("evaluation", type=Path)
    parser.add_argument("--scenarios", type=int, default=20)
    options = parser.parse_args()
    methods: dict[str, Place] = {"ours": place_labels, "adjustText": adjusted}
    for name, method in methods.items():
        tally = Tally()
        setattr(trajectories, "place_labels", counted(method, tally))  # noqa: B010
        with house_style():
            for number in range(options.scenarios):
                plt.close(trajectories.picture(name, read_scenario(options.evaluation, number)))
        sys.stdout.write(f"{name}: {tally}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
