"""Read the run folders of `train` and `reproduce` for comparison."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from skystack.errors import InputError, error_context, exists, printable
from skystack.io.json_file import MAX_BYTES, decode
from skystack.io.names import Name, Seed
from skystack.io.toml_file import parse_toml
from skystack.io.validation import convert
from skystack.reporting.families import family_of
from skystack.reporting.learning_curves import at_the_end
from skystack.reporting.results import Row, Update, read_file, read_run, read_updates, row_order

NOT_COMPARED = ("name", "description")
"""Settings that do not affect training."""


class TrainingRun(NamedTuple):
    """One training run: its origin, settings and learning curve."""

    curve: str
    """The plotted line it belongs to: the run, plus the experiment if the run has several."""
    run: str
    experiment: str
    seed: int | None
    """From the policy file, so None if the training has not finished."""
    updates: list[Update]
    settings: dict[str, Any]
    """By dotted key, as for `--set`."""

    @property
    def family(self) -> str:
        return family_of(self.experiment, self.settings.get("task.name"))

    @property
    def summary(self) -> dict[str, Any]:
        """Its line of the table; success and instructions are final values of the running mean."""
        last = self.updates[-1]
        return {
            "run": self.run,
            "experiment": self.experiment,
            "seed": self.seed,
            "steps": last.steps,
            "wall_s": last.wall_s,
            "success": at_the_end(self.updates, "success"),
            "instructions": at_the_end(self.updates, "instructions"),
        }


class RunRow(NamedTuple):
    """A row of a run's results."""

    run: str
    row: Row


class Runs(NamedTuple):
    """The contents of several run folders."""

    trainings: list[TrainingRun]
    rows: list[RunRow]
    """In the order of the tables, which puts equal rows of different runs next to each other."""


def is_reproduction(folder: Path) -> bool:
    """Whether `skystack reproduce` wrote the folder."""
    return exists(folder / "results.json")


def read_runs(folders: Sequence[Path]) -> Runs:
    """Read run folders. Raises InputError that names what is missing, damaged or given twice."""
    trainings: list[TrainingRun] = []
    rows: list[RunRow] = []
    for folder, name in zip(folders, short_names(folders), strict=True):
        if is_reproduction(folder):
            run = read_run(folder)
            rows += [RunRow(name, row) for row in run.results.rows]
            several = len(run.results.experiments) > 1
            for each in run.results.train:
                curve = f"{name}, {each.experiment}" if several else name
                learned = _read_training(run.training(each), name)
                trainings.append(learned._replace(curve=curve, seed=each.seed))
        elif exists(folder / "metrics.jsonl"):
            trainings.append(_read_training(folder, name))
        elif not exists(folder):
            raise InputError(f"{folder} does not exist")
        else:
            raise InputError(
                f"{folder}: not a run folder (allowed: a folder of train, reproduce, flight-school "
                "or evaluate --traffic)"
            )
    return Runs(trainings, sorted(rows, key=lambda each: row_order(each.row)))


def short_names(folders: Sequence[Path]) -> list[str]:
    """Shorten paths to their fewest unique last parts. Raises InputError for duplicates."""
    parts = [folder.resolve().parts for folder in folders]
    names = []
    for folder, own in zip(folders, parts, strict=True):
        if parts.count(own) > 1:
            raise InputError(f"{folder}: given twice")
        unique = (
            own[-count:]
            for count in range(1, len(own) + 1)
            if sum(each[-count:] == own[-count:] for each in parts) == 1
        )
        names.append(printable("/".join(next(unique))))
    return names


def differences(settings: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The settings that differ: by key, the value of each name, None if unset."""
    keys = dict.fromkeys(key for each in settings.values() for key in each)
    found = {
        key: {name: each.get(key) for name, each in settings.items()}
        for key in keys
        if key not in NOT_COMPARED
    }
    return {
        key: values
        for key, values in found.items()
        if any(value != other for value in values.values() for other in values.values())
    }


class _Configured(msgspec.Struct):
    """The part of `config.toml` that is read."""

    name: Name


class _Described(msgspec.Struct):
    """The part of `policy.json` that is read."""

    seed: Seed


def _read_training(folder: Path, run: str) -> TrainingRun:
    path = folder / "config.toml"
    data = read_file(path, MAX_BYTES)
    with error_context(f"{path}: damaged"):
        config = parse_toml(data)
        experiment = convert(config, _Configured).name
    path = folder / "policy.json"
    seed = decode(read_file(path, MAX_BYTES), _Described, str(path)).seed if path.exists() else None
    return TrainingRun(run, run, experiment, seed, read_updates(folder), _flat(config))


def _flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Flatten `{"ppo": {"gamma": 0.99}}` to `{"ppo.gamma": 0.99}`."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        inner = isinstance(value, dict)
        flat |= _flat(value, f"{before}{key}.") if inner else {f"{before}{key}": value}
    return flat
