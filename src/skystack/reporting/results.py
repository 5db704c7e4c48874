"""What a run folder says about itself: `results.json`, `bound.json` and the curves of training."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec

from skystack.errors import InputError, error_context
from skystack.evaluation.statistics import Estimate
from skystack.io.files import MOST_BYTES, read_whole
from skystack.io.json_file import decode
from skystack.io.names import Name
from skystack.platforms.registry import OWN

Figure = Annotated[float, msgspec.Meta(ge=-1e15, le=1e15)]
Count = Annotated[int, msgspec.Meta(ge=0, le=10**15)]
Number = Figure | None
"""JSON has no NaN: what could not be measured is null."""

SIMULATORS = {OWN: "skystack", "bluebird": "BluebirdDT", "bluesky": "BlueSky"}
"""Names of the platforms, in the order in which tables show them."""
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
    ("do-nothing", False): "do nothing",
    ("vertical", False): "vertical",
    ("vertical", True): "vertical, stacked",
    ("avoidance", False): "avoidance",
    ("avoidance", True): "avoidance, stacked",
    ("avoidance-large", False): "avoidance, 37 actions",
    ("avoidance-large", True): "avoidance, 37 actions, stacked",
    ("avoidance-tuned", False): "avoidance, tuned",
    ("avoidance-tuned", True): "avoidance, tuned and stacked",
    ("avoidance-best", False): "avoidance, ours, unstacked",
    ("avoidance-best", True): "avoidance, ours, stacked",
}
"""Names of (experiment, stacking), in the order in which tables and figures show them."""
NO_OP_NAME = "do-nothing"
BOUND_FAMILY = "lateral"
"""Whose fewest possible clearances are known."""
FAMILIES = {
    "lateral": "Lateral navigation",
    "vertical": "Vertical control",
    "avoidance": "Lateral navigation and avoidance",
}
"""Titles of the families of experiments, in their order. A family is one task on one kind of
scenarios: only within it can rows be compared."""


def family_of(experiment: str) -> str:
    """The first word of an experiment's name, if that is a family; else the first of all."""
    word = experiment.partition("-")[0]
    return word if word in FAMILIES else next(iter(FAMILIES))


class Paper(msgspec.Struct, frozen=True):
    """What the paper states for a row."""

    clearances_mean: Figure
    clearances_std: Number = None


class Statistics(msgspec.Struct, frozen=True):
    """Means over trainings of one measure, with their 95 % intervals."""

    mean: Estimate
    iqm: Estimate
    """Interquartile."""


class RowName(msgspec.Struct, frozen=True):
    """Which row is meant."""

    experiment: Name
    stacking: bool


class Difference(msgspec.Struct, frozen=True):
    """How a first row differs from a second in one measure."""

    difference: Estimate
    """First less second."""
    probability_less: Estimate
    """That a training of the first comes out lower than one of the second."""


class Comparison(msgspec.Struct, frozen=True):
    """Two rows on the same scenarios."""

    first: RowName
    second: RowName
    measures: dict[str, Difference]


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One line of the comparison: a policy with or without online action-stacking.

    Clearances and instructions are per scenario, all aircraft together; rates are fractions of
    scenarios. In `rows` it covers all training seeds, in `rows_by_seed` one.
    """

    experiment: Name
    platform: Name
    stacking: bool
    seeds: Count
    """How many trainings."""
    seed: Count | None = None
    """Which training; only in `rows_by_seed`."""
    episodes: Count
    clearances_mean: Number
    clearances_std: Number
    instructions_mean: Number
    success_rate: Number
    correct_exit_rate: Number
    excursion_rate: Number
    few_clearances_rate: Number
    loss_of_separation_count: Count
    paper: Paper | None = None
    wall_s: Number = None
    """What flying took."""
    same_clearances_rate: Number = None
    """Scenarios with the same clearances as in our simulator; only in `platforms`."""
    statistics: dict[str, Statistics] = {}
    """Of every measure (`skystack.evaluation.statistics`); only in `rows`."""

    @property
    def family(self) -> str:
        """That of its experiment."""
        return family_of(self.experiment)

    @property
    def policy(self) -> str:
        """As readers know it: `damped and stacked`."""
        way = "stacked" if self.stacking else "plain"
        return READABLE_NAMES.get((self.experiment, self.stacking), f"{self.experiment}, {way}")

    @property
    def name(self) -> str:
        """The policy, and the simulator where it is not ours."""
        return self.policy if self.platform == OWN else f"{self.policy} ({self.platform})"

    @property
    def title(self) -> str:
        """The name at the head of something."""
        return self.name[:1].upper() + self.name[1:]

    @property
    def slug(self) -> str:
        """Its part of file names: `lateral-stacked`."""
        way = "stacked" if self.stacking else "plain"
        platform = "" if self.platform == OWN else f"-{self.platform}"
        return f"{self.experiment}{platform}-{way}"


class Training(msgspec.Struct, frozen=True):
    """One training: how long it was and how long it took."""

    experiment: Name
    seed: Count
    steps: Count
    wall_s: Figure
    steps_per_s: Figure


class Results(msgspec.Struct, frozen=True, kw_only=True):
    """The object of `results.json`."""

    rows: list[Row]
    rows_by_seed: list[Row]
    train: list[Training]
    wall_s: Figure
    machine: str
    version: str
    command: str
    quick: bool
    platforms: list[Row] = []
    """The first seed's policies in several simulators, on the same scenarios."""
    comparisons: list[Comparison] = []
    kept: list[str] = []
    """Pieces that an earlier run had finished: they are not in `wall_s`."""

    def row(self, experiment: str, stacking: bool) -> Row | None:
        """One of `rows`, if it is there."""
        found = (
            row for row in self.rows if (row.experiment, row.stacking) == (experiment, stacking)
        )
        return next(found, None)

    @property
    def families(self) -> dict[str, list[Row]]:
        """The rows of each family that has any."""
        grouped = {
            family: [row for row in self.rows if row.family == family] for family in FAMILIES
        }
        return {family: rows for family, rows in grouped.items() if rows}

    @property
    def experiments(self) -> list[str]:
        """The trained ones, in the order of the tables."""
        return sorted({training.experiment for training in self.train}, key=_experiment_order)

    def experiments_of(self, family: str) -> list[str]:
        """The trained ones of a family."""
        members = {row.experiment for row in self.families.get(family, [])}
        return [name for name in self.experiments if name in members]


class Bound(msgspec.Struct, frozen=True):
    """The fewest clearances that any controller needs, on average over some scenarios."""

    clearances_mean: Figure
    scenarios: Count


class Update(msgspec.Struct, frozen=True):
    """One update of a training: means over the scenarios that ended in it; null where none did."""

    steps: Count
    wall_s: Number = None
    """Since training began."""
    episode_return: Number = msgspec.field(default=None, name="return")
    success: Number = None
    correct_exit: Number = None
    excursion: Number = None
    few_instructions: Number = None
    instructions: Number = None
    bursts: Number = None
    episodes: Figure = 0.0
    """How many scenarios ended."""


@dataclass(frozen=True)
class Run:
    """A run folder and what its JSON files say; rows are in the order of the tables."""

    folder: Path
    results: Results
    bound: Bound | None

    def bound_of(self, family: str) -> Bound | None:
        """The fewest clearances possible, where they are known."""
        return self.bound if family == BOUND_FAMILY else None

    def first_seed(self, row: Row) -> int:
        """The training whose flights stand for a row in pictures and histograms: the lowest."""
        key = (row.experiment, row.platform, row.stacking)
        seeds = [
            one.seed
            for one in self.results.rows_by_seed
            if (one.experiment, one.platform, one.stacking) == key and one.seed is not None
        ]
        return min(seeds, default=0)

    def evaluation(self, row: Row) -> Path:
        """The folder with the flights of a row's first seed."""
        way = "stacked" if row.stacking else "plain"
        name = f"{row.experiment}-s{self.first_seed(row)}-{row.platform}-{way}"
        return self.folder / "evaluation" / name

    def updates(self, training: Training) -> list[Update]:
        """The learning curve of a training. Raises InputError for a missing or damaged file."""
        return read_updates(self.training(training))

    def training(self, training: Training) -> Path:
        """The folder of a training."""
        return self.folder / "train" / f"{training.experiment}-s{training.seed}"


def read_updates(folder: Path) -> list[Update]:
    """The learning curve in a training's folder. Raises InputError: missing or damaged file."""
    path = folder / "metrics.jsonl"
    *lines, last = read_file(path).split(b"\n")
    with suppress(InputError):  # a running or killed training may have written part of a line
        decode(last, Update, str(path))
        lines.append(last)
    if not lines:
        raise InputError(f"{path}: holds no whole line (allowed: one JSON object a line)")
    return [
        decode(line, Update, f"{path}: line {number}") for number, line in enumerate(lines, start=1)
    ]


def read_run(folder: Path) -> Run:
    """Read what is small. Raises InputError that names a missing or damaged file."""
    path = folder / "results.json"
    results = decode(read_file(path), Results, str(path))
    for table in ("rows", "platforms", "rows_by_seed"):
        rows: list[Row] = getattr(results, table)
        # On file systems that ignore case they would share their files.
        keys = [
            (row.experiment.lower(), row.stacking, row.platform.lower(), row.seed) for row in rows
        ]
        _check_once(f"{path}: {table}", keys)
    _check_once(f"{path}: train", [(run.experiment.lower(), run.seed) for run in results.train])
    ordered = msgspec.structs.replace(
        results,
        rows=in_order(results.rows),
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
        raise InputError(f"{where}: {twice} stands in it twice (allowed: once)")


def in_order(rows: Iterable[Row]) -> list[Row]:
    """Known rows as listed above, unknown ones after them by name."""
    return sorted(rows, key=row_order)


def row_order(row: Row) -> tuple[int, str, bool, int, str]:
    """What rows are sorted by."""
    known, simulators = list(READABLE_NAMES), list(SIMULATORS)
    key = (row.experiment, row.stacking)
    place = known.index(key) if key in known else len(known)
    where = simulators.index(row.platform) if row.platform in simulators else len(simulators)
    return place, row.experiment, row.stacking, where, row.platform


def _experiment_order(experiment: str) -> tuple[int, str]:
    known = [name for name, _ in READABLE_NAMES]
    return (known.index(experiment) if experiment in known else len(known)), experiment


def read_file(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """A whole file. Raises InputError that names it when it cannot be read or is too large."""
    with error_context(str(path)):
        return read_whole(path, most_bytes)
