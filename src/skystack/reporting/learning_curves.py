"""Learning curves: return, success and its criteria, instructions and bursts over steps."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from skystack.reporting.results import Update
from skystack.reporting.style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    LINES,
    MUTED,
    ORANGE,
    SERIES,
    VERMILION,
    grid_of_axes,
)

WINDOW = 0.03
"""The window of the running mean, as a fraction of the training run."""
LEARNED = 0.8
"""The success rate at which a policy counts as having learned its task."""
CRITERIA = (
    ("correct_exit", GREEN, "correct exit"),
    ("excursion", VERMILION, "no excursion"),
    ("few_instructions", ORANGE, "few instructions"),
)
"""Field, colour and name of each criterion of success."""

Curves = Sequence[Sequence[Update]]
"""The updates of one experiment, one sequence per seed."""


def learning_curves(title: str, seeds: Curves) -> Figure:
    """Plot one experiment: return; success and its criteria; instructions and bursts."""
    figure, (returns, rates, counts) = grid_of_axes(3, 1, (5.0, 6.0), sharex=True)
    returns.set_title(title)
    _draw(returns, seeds, "episode_return", INK)
    returns.set_ylabel("return")
    _draw_success(rates, seeds)
    _legend(rates)
    _draw(counts, seeds, "instructions", INK, label="instructions")
    _draw(counts, seeds, "bursts", BLUE, style=1, label="bursts")
    counts.set_ylabel("per scenario")
    counts.set_ylim(bottom=0.0)
    _legend(counts)
    _steps(counts)
    return figure


def convergence(experiments: Mapping[str, Curves]) -> Figure:
    """Plot experiments side by side on common axes: return above, success and criteria below."""
    columns = len(experiments)
    figure, panels = grid_of_axes(2, columns, (3.6 * columns, 4.9), sharex=True, sharey="row")
    for column, (title, seeds) in enumerate(experiments.items()):
        returns, rates = panels[column], panels[columns + column]
        returns.set_title(title)
        _draw(returns, seeds, "episode_return", INK)
        _draw_success(rates, seeds)
        _mark_learned(rates, seeds)
        _steps(rates)
        for ax in (returns, rates):
            ax.label_outer()
    panels[0].set_ylabel("return")
    handles, labels = panels[columns].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=4, handlelength=2.6)
    return figure


def steps_until(share: float, seeds: Curves) -> float | None:
    """The steps at which mean success first reaches a share; None if it never does."""
    smooth = _smooth(seeds, "success")
    if not smooth:
        return None
    steps, success = mean_over_seeds(smooth)
    reached = success >= share
    return float(steps[np.argmax(reached)]) if reached.any() else None


def success_curves(experiments: Mapping[str, Curves]) -> Figure:
    """Plot the success of all experiments on the same axes."""
    figure, (axes,) = grid_of_axes(1, 1, (5.0, 3.4))
    axes.set_title("Success during training")
    _draw_all(axes, experiments, "success")
    _rates(axes)
    _common_legend(figure, axes)
    return figure


def overlaid_curves(runs: Mapping[str, Curves]) -> Figure:
    """Plot return, success and instructions of several runs, one panel per measure."""
    figure, (returns, rates, counts) = grid_of_axes(1, 3, (10.5, 3.9), sharex=True)
    _draw_all(returns, runs, "episode_return")
    returns.set_title("Return")
    _draw_all(rates, runs, "success")
    rates.set_title("Success")
    _rates(rates)
    _draw_all(counts, runs, "instructions")
    counts.set_title("Instructions")
    counts.set_ylabel("per scenario")
    counts.set_ylim(bottom=0.0)
    _common_legend(figure, returns)
    return figure


def at_the_end(updates: Sequence[Update], field: str) -> float | None:
    """The last value of the running mean of a training run; None if there is none."""
    smooth = _smooth([updates], field)
    return float(smooth[0][1][-1]) if smooth else None


def running_mean(
    values: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """The weighted mean over a window around each value, shorter at the ends; ignores NaN."""
    window = np.ones(2 * round(WINDOW * len(values) / 2.0) + 1)
    known = np.isfinite(values) & (weights > 0.0)
    total = np.convolve(np.where(known, values * weights, 0.0), window, mode="same")
    weight = np.convolve(np.where(known, weights, 0.0), window, mode="same")
    # An unknown value stays unknown, whatever its neighbours are.
    return np.where(known, total / np.where(known, weight, 1.0), np.nan)


def mean_over_seeds(
    curves: Sequence[tuple[Float[np.ndarray, " _"], Float[np.ndarray, " _"]]],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Steps and mean of (steps, value) curves, at the first curve's steps that all curves reach."""
    steps = curves[0][0]
    steps = steps[steps <= min(at[-1] for at, _ in curves)]
    return steps, np.mean([np.interp(steps, at, value) for at, value in curves], axis=0)


def _draw(
    axes: Axes,
    seeds: Curves,
    field: str,
    colour: str,
    style: int = 0,
    label: str | None = None,
    thin: bool = True,
    width: float = 1.8,
) -> None:
    """Draw the mean over the seeds as a thick line and, with `thin`, each seed as a thin line."""
    axes.grid(axis="y", color=FAINT, linewidth=0.5)
    if thin:
        for updates in seeds:
            axes.plot(*_values(updates, field), color=colour, linewidth=0.5, alpha=0.35)
    smooth = _smooth(seeds, field)
    if smooth:
        axes.plot(
            *mean_over_seeds(smooth),
            color=colour,
            linewidth=width,
            linestyle=LINES[style],
            label=label,
        )


def _draw_all(axes: Axes, runs: Mapping[str, Curves], field: str) -> None:
    """Draw one measure of several runs, each with its own colour and dash pattern."""
    for number, (name, seeds) in enumerate(runs.items()):
        colour = SERIES[number % len(SERIES)]
        _draw(axes, seeds, field, colour, style=number % len(LINES), label=name)
    _steps(axes)


def _common_legend(figure: Figure, axes: Axes) -> None:
    """Draw one legend below all axes, which show the same runs."""
    if axes.get_legend_handles_labels()[0]:
        figure.legend(
            *axes.get_legend_handles_labels(),
            loc="outside lower center",
            ncols=3,
            labelcolor=MUTED,
            handlelength=2.4,
        )


def _values(
    updates: Sequence[Update], field: str
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Steps and values; for `excursion`, the rate of scenarios without one."""
    steps = np.array([update.steps for update in updates], dtype=float)
    values = np.array([getattr(update, field) for update in updates], dtype=float)
    return steps, 1.0 - values if field == "excursion" else values


def _smooth(
    seeds: Curves, field: str
) -> list[tuple[Float[np.ndarray, " _"], Float[np.ndarray, " _"]]]:
    """Steps and running mean of each seed, where defined."""
    smooth = []
    for updates in seeds:
        steps, values = _values(updates, field)
        mean = running_mean(values, np.array([update.episodes for update in updates]))
        known = np.isfinite(mean)
        if known.any():
            smooth.append((steps[known], mean[known]))
    return smooth


def _draw_success(axes: Axes, seeds: Curves) -> None:
    """Draw success with its criteria on top, which shows the criterion that limits it."""
    _draw(axes, seeds, "success", BLUE, label="success", width=3.6)
    for style, (field, colour, label) in enumerate(CRITERIA, start=1):
        _draw(axes, seeds, field, colour, style=style, label=label, thin=False, width=1.6)
    _rates(axes)


def _mark_learned(axes: Axes, seeds: Curves) -> None:
    """Mark the steps at which success first reaches `LEARNED`, or state that it never does."""
    steps = steps_until(LEARNED, seeds)
    if steps is None:
        text = f"success stays below {LEARNED:.0%}"
    else:
        text = f"{LEARNED:.0%} success first at {steps / 1e6:.2g} million steps"
        axes.axvline(steps, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
    axes.set_title(text, fontsize=8.5, fontweight="normal", color=MUTED, pad=5.0)


def _rates(axes: Axes) -> None:
    axes.set_ylim(-0.03, 1.03)
    axes.set_ylabel("share of scenarios")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.0%}"))


def _legend(axes: Axes) -> None:
    """Draw the legend above the axes; inside, curves would run through it."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=4,
            borderaxespad=0.2,
            handlelength=2.0,
            handletextpad=0.5,
            labelcolor=MUTED,
            columnspacing=0.9,
            fontsize=7.5,
        )


def _steps(axes: Axes) -> None:
    axes.set_xlabel("training steps [million]")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / 1e6:g}"))
    axes.margins(x=0.01)
