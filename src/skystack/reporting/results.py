"""The contents of a run folder: `results.json`, `bound.json` and the learning curves."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec

from skystack.errors import InputError, error_context
from skystack.evaluation.estimate import Estimate
from skystack.evaluation.summary import evaluation_folder, is_no_op, no_op_name, trained_name
from skystack.io.files import MOST_BYTES, read_whole
from skystack.io.json_file import decode
from skystack.io.names import Name
from skystack.platforms.registry import OWN
from skystack.reporting.families import BOUND_FAMILY, family_of, family_order

Figure = Annotated[float, msgspec.Meta(ge=-1e15, le=1e15)]
Count = Annotated[int, msgspec.Meta(ge=0, le=10**15)]
Number = Figure | None
"""A value that could not be measured is null, because JSON has no NaN."""
NotNegative = Annotated[float, msgspec.Meta(ge=0.0, le=1e15)] | None
Rate = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] | None

SIMULATORS = {OWN: "skystack", "bluebird": "BluebirdDT", "bluesky": "BlueSky"}
"""Names of the platforms, in the order of the tables."""
READABLE_NAMES = {
    ("lateral-undamped", False): "undamped",
    ("lateral-undamped", True): "undamped, stacked",
    ("lateral", False): "damped",
    ("lateral", True): "damped and stacked",
    ("lateral-large", False): "37 actions",
    ("lateral-large", True): "37 actions, stacked",
    ("lateral-tuned", False): "tuned",
    ("lateral-tuned", True): "tuned and stacked",
    ("lateral-best", False): "ours, unstacked",
    ("lateral-best", True): "ours, stacked",
    ("lateral-shipped", True): "damped and stacked, shipped",
    ("lateral-best-shipped", True): "ours, stacked, shipped",
    ("do-nothing-lateral", False): "do nothing",
    ("vertical", False): "vertical",
    ("vertical", True): "vertical, stacked",
    ("do-nothing-vertical", False): "vertical, do nothing",
    ("avoidance", False): "avoidance",
    ("avoidance", True): "avoidance, stacked",
    ("avoidance-large", False): "avoidance, 37 actions",
    ("avoidance-large", True): "avoidance, 37 actions, stacked",
    ("avoidance-tuned", False): "avoidance, tuned",
    ("avoidance-tuned", True): "avoidance, tuned and stacked",
    ("avoidance-best", False): "avoidance, ours, unstacked",
    ("avoidance-best", True): "avoidance, ours, stacked",
    ("do-nothing-avoidance", False): "avoidance, do nothing",
}
"""Display names by (experiment, stacking), in the order of tables and figures."""
TRAINED_MARGIN = 0.3
"""A policy counts as trained if its success rate exceeds that of doing nothing by this much."""
ROUNDING = 1e-9
"""The tolerance for rounding errors: in binary, 0.27 + 0.3 exceeds 0.57."""


class Paper(msgspec.Struct, frozen=True):
    """The paper's values for a row."""

    clearances_mean: Figure
    clearances_std: Number = None


class Statistics(msgspec.Struct, frozen=True):
    """Means of one measure over the seeds, with their 95 % intervals."""

    mean: Estimate
    iqm: Estimate
    """The interquartile mean."""


class RowName(msgspec.Struct, frozen=True):
    """The key of a row."""

    experiment: Name
    stacking: bool


class Difference(msgspec.Struct, frozen=True):
    """The difference between two rows in one measure."""

    difference: Estimate
    """First minus second."""
    probability_less: Estimate
    """The probability that a seed of the first has a lower value than a seed of the second."""


class Comparison(msgspec.Struct, frozen=True):
    """The comparison of two rows on the same scenarios."""

    first: RowName
    second: RowName
    measures: dict[str, Difference]


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One line of the comparison: a policy with or without online action-stacking.

    Clearances and instructions are per scenario, all aircraft together; rates are fractions of
    scenarios. In `rows` it covers all training seeds, in `rows_by_seed` one.
    """

    experiment: Name
    task: Name | None = None
    """The name of the experiment's task; old files do not state it."""
    platform: Name
    stacking: bool
    seeds: Count
    """The number of training seeds."""
    seed: Count | None = None
    """The training seed; only in `rows_by_seed`."""
    episodes: Count
    clearances_mean: NotNegative
    clearances_std: NotNegative
    instructions_mean: NotNegative
    exit_offset_nm_mean: NotNegative = None
    """The mean distance from the exit fix at the exit; old files do not state it."""
    success_rate: Rate
    correct_exit_rate: Rate
    excursion_rate: Rate
    few_clearances_rate: Rate
    loss_of_separation_count: Count
    paper: Paper | None = None
    wall_s: Number = None
    """The wall time of the evaluation."""
    same_clearances_rate: Rate = None
    """The share of scenarios with the same clearances as in skystack; only in `platforms`."""
    statistics: dict[str, Statistics] = {}
    """By measure (`skystack.evaluation.statistics`); only in `rows`."""

    @property
    def family(self) -> str:
        """The family of its experiment."""
        return family_of(self.experiment, self.task)

    @property
    def is_no_op(self) -> bool:
        """Whether no instruction was issued, because there was no policy."""
        return is_no_op(self.experiment)

    @property
    def is_shipped(self) -> bool:
        """Whether the policy ships with skystack and was not trained in this run."""
        return trained_name(self.experiment) != self.experiment

    @property
    def policy(self) -> str:
        """The readable name of the policy, such as `damped and stacked`."""
        way = "stacked" if self.stacking else "unstacked"
        return READABLE_NAMES.get(_display_key(self), f"{self.experiment}, {way}")

    @property
    def name(self) -> str:
        """The policy, with the simulator in brackets unless it is skystack."""
        return self.policy if self.platform == OWN else f"{self.policy} ({self.platform})"

    @property
    def title(self) -> str:
        """The name with its first letter capitalised."""
        return self.name[:1].upper() + self.name[1:]

    @property
    def slug(self) -> str:
        """The part of file names that identifies the row, such as `lateral-stacked`."""
        way = "stacked" if self.stacking else "plain"
        platform = "" if self.platform == OWN else f"-{self.platform}"
        return f"{self.experiment}{platform}-{way}"


class Training(msgspec.Struct, frozen=True):
    """The steps and the duration of one training run."""

    experiment: Name
    seed: Count
    steps: Count
    wall_s: Figure
    steps_per_s: Figure


class Results(msgspec.Struct, frozen=True, kw_only=True):
    """The contents of `results.json`."""

    rows: Annotated[list[Row], msgspec.Meta(min_length=1)]
    rows_by_seed: list[Row]
    train: list[Training]
    wall_s: Figure
    machine: str
    version: str
    command: str
    quick: bool
    platforms: list[Row] = []
    """The policies of the first seed in several simulators, on the same scenarios."""
    sampled: list[Row] = []
    """The same policies as in `rows`, with sampled actions."""
    comparisons: list[Comparison] = []
    kept: list[str] = []
    """Pieces that an earlier run had finished; `wall_s` does not include them."""

    def row(self, experiment: str, stacking: bool) -> Row | None:
        """The row with this key, if any."""
        found = (
            row for row in self.rows if (row.experiment, row.stacking) == (experiment, stacking)
        )
        return next(found, None)

    def is_trained(self, row: Row) -> bool:
        """Whether a row's policy succeeds more often than doing nothing, by `TRAINED_MARGIN`.

        Where doing nothing was not evaluated, it counts as never succeeding.
        """
        rates = [each.success_rate for each in self.families[row.family] if each.is_no_op]
        floor = max((rate for rate in rates if rate is not None), default=0.0)
        least = floor + TRAINED_MARGIN - ROUNDING
        return row.success_rate is not None and row.success_rate >= least

    def drawn(self, rows: Iterable[Row]) -> list[Row]:
        """The rows whose flights and counts are drawn: trained policies, and doing nothing."""
        return [row for row in rows if row.is_no_op or self.is_trained(row)]

    @property
    def families(self) -> dict[str, list[Row]]:
        """The rows by family."""
        return {
            family: [row for row in self.rows if row.family == family]
            for family in family_order(row.family for row in self.rows)
        }

    @property
    def experiments(self) -> list[str]:
        """The trained experiments, in the order of the tables."""
        return sorted({training.experiment for training in self.train}, key=_experiment_order)

    def experiments_of(self, family: str) -> list[str]:
        """The trained experiments of a family."""
        members = {row.experiment for row in self.families.get(family, [])}
        return [name for name in self.experiments if name in members]


class Bound(msgspec.Struct, frozen=True):
    """The fewest clearances with which turns in steps of 10 degrees can succeed, as a mean."""

    clearances_mean: Figure
    scenarios: Count


class Update(msgspec.Struct, frozen=True):
    """One training update: means over the scenarios that ended in it, null if none did."""

    steps: Count
    wall_s: Number = None
    """Since the start of training."""
    episode_return: Number = msgspec.field(default=None, name="return")
    success: Number = None
    correct_exit: Number = None
    excursion: Number = None
    few_instructions: Number = None
    instructions: Number = None
    bursts: Number = None
    episodes: Figure = 0.0
    """The number of scenarios that ended."""


@dataclass(frozen=True)
class Run:
    """A run folder and the contents of its JSON files. Rows are in the order of the tables."""

    folder: Path
    results: Results
    bound: Bound | None

    def bound_of(self, family: str) -> Bound | None:
        """The fewest possible clearances of a family, if known."""
        return self.bound if family == BOUND_FAMILY else None

    def evaluations(self, row: Row) -> list[Path]:
        """The evaluation folders of a row, one for each seed in ascending order."""
        key = (row.experiment, row.platform, row.stacking)
        seeds = sorted(
            one.seed
            for one in self.results.rows_by_seed
            if (one.experiment, one.platform, one.stacking) == key and one.seed is not None
        )
        return [
            evaluation_folder(
                self.folder / "evaluation", row.experiment, seed, row.stacking, row.platform
            )
            for seed in seeds or [0]
        ]

    def evaluation(self, row: Row) -> Path:
        """The evaluation folder of a row's first seed, whose flights the pictures show."""
        return self.evaluations(row)[0]

    def updates(self, training: Training) -> list[Update]:
        """The learning curve of a training run. Raises InputError for a missing or damaged file."""
        return read_updates(self.training(training))

    def training(self, training: Training) -> Path:
        """The folder of a training run."""
        return self.folder / "train" / f"{training.experiment}-s{training.seed}"


def read_updates(folder: Path) -> list[Update]:
    """Read the learning curve of a training run. Raises InputError for a bad or missing file."""
    path = folder / "metrics.jsonl"
    *lines, last = read_file(path).split(b"\n")
    with suppress(InputError):  # the last line is incomplete if training is running or was killed
        decode(last, Update, str(path))
        lines.append(last)
    if not lines:
        raise InputError(f"{path}: contains no complete line (allowed: one JSON object per line)")
    return [
        decode(line, Update, f"{path}: line {number}") for number, line in enumerate(lines, start=1)
    ]


def read_run(folder: Path) -> Run:
    """Read a run folder's JSON files. Raises InputError that names a missing or damaged file."""
    path = folder / "results.json"
    results = decode(read_file(path), Results, str(path))
    for table in ("rows", "sampled", "platforms", "rows_by_seed"):
        rows: list[Row] = getattr(results, table)
        # Rows that differ only in case would share files on some file systems.
        keys = [
            (row.experiment.lower(), row.stacking, row.platform.lower(), row.seed) for row in rows
        ]
        _check_once(f"{path}: {table}", keys)
    _check_once(f"{path}: train", [(run.experiment.lower(), run.seed) for run in results.train])
    ordered = msgspec.structs.replace(
        results,
        rows=in_order(results.rows),
        sampled=in_order(results.sampled),
        platforms=in_order(results.platforms),
        rows_by_seed=sorted(results.rows_by_seed, key=lambda row: (row_order(row), row.seed or 0)),
        train=sorted(results.train, key=lambda run: (_experiment_order(run.experiment), run.seed)),
    )
    path = folder / "bound.json"
    bound = decode(read_file(path), Bound, str(path)) if path.exists() else None
    return Run(folder, ordered, bound)


def _check_once(where: str, keys: Sequence[tuple[object, ...]]) -> None:
    if len(set(keys)) < len(keys):
        twice = next(key for key in keys if keys.count(key) > 1)
        raise InputError(f"{where}: {twice} occurs twice (allowed: once)")


def in_order(rows: Iterable[Row]) -> list[Row]:
    """Sort rows: known ones as in `READABLE_NAMES`, then unknown ones by name."""
    return sorted(rows, key=row_order)


def row_order(row: Row) -> tuple[int, str, bool, int, str]:
    """The sort key of a row."""
    known, simulators = list(READABLE_NAMES), list(SIMULATORS)
    key = _display_key(row)
    place = known.index(key) if key in known else len(known)
    where = simulators.index(row.platform) if row.platform in simulators else len(simulators)
    return place, row.experiment, row.stacking, where, row.platform


def _display_key(row: Row) -> tuple[str, bool]:
    """The key of a row in `READABLE_NAMES`."""
    return (no_op_name(row.family) if row.is_no_op else row.experiment), row.stacking


def _experiment_order(experiment: str) -> tuple[int, str]:
    known = [name for name, _ in READABLE_NAMES]
    return (known.index(experiment) if experiment in known else len(known)), experiment


def read_file(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Read a whole file. Raises InputError that names it if it is unreadable or too large."""
    with error_context(str(path)):
        return read_whole(path, most_bytes)
