"""Reading experiments: by name or from a file, with single values changed, every key checked."""

from collections.abc import Iterable, Mapping
from copy import deepcopy
from importlib.resources import files
from os import fspath
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from skystack.airspace.sector_file import Point, SectorEntry
from skystack.airspace.sectors import named_or_read
from skystack.errors import InputError, error_context, unknown_name
from skystack.io.files import AnyPath, read_whole
from skystack.io.json_file import MAX_BYTES, convert
from skystack.io.names import Name
from skystack.io.toml_file import parse_toml
from skystack.learning.settings import PPOSettings, Pretraining
from skystack.simulator.fleet import AircraftType
from skystack.tasks.build import build_task
from skystack.tasks.settings import RewardSettings, TaskSettings

_FOLDER = files("skystack").joinpath("experiments")


class Experiment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A whole experiment: a task and how it is learned."""

    name: Name
    description: str = ""
    task: TaskSettings = TaskSettings()
    ppo: PPOSettings = PPOSettings()
    pretraining: Pretraining | None = None


_ENTRIES: dict[str, type[msgspec.Struct]] = {
    "": Experiment,
    "task": TaskSettings,
    "task.reward": RewardSettings,
    "task.fleet": AircraftType,
    "task.sector": SectorEntry,
    "task.sector.origin": Point,
    "ppo": PPOSettings,
    "pretraining": Pretraining,
    "pretraining.reward": RewardSettings,
}


def experiment_names() -> list[str]:
    """The experiments that come with the package."""
    names = (entry.name for entry in _FOLDER.iterdir())
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml"))


def load_experiment(name: AnyPath, changes: Iterable[str] = ()) -> Experiment:
    """The experiment of a name or in a `.toml` file, with `key=value` changes.

    Raises InputError for an unknown name or key, or a value of the wrong type or range.
    """
    name = fspath(name)
    if name.endswith(".toml"):
        where = name
        with error_context(name):
            data = read_whole(Path(name), MAX_BYTES)
    elif name in experiment_names():
        where = f"experiment {name}"
        data = _FOLDER.joinpath(f"{name}.toml").read_bytes()
    else:
        raise unknown_name("experiment", name, experiment_names(), [f"{name}.toml"])
    with error_context(where):
        values = parse_toml(data)
    _read_sector(values, Path(name).parent)
    changes = list(changes)
    before = deepcopy(values)
    for change in changes:
        _set(values, change)
    _read_sector(values, None)
    try:
        return experiment_from(values, where)
    except InputError as error:
        if not changes or not _holds(before, where):
            raise
        raise InputError(str(error).replace(f"{where}: ", "--set: ", 1)) from None


def _holds(values: Mapping[str, Any], where: str) -> bool:
    """Whether it was an experiment before anything was changed."""
    try:
        experiment_from(values, where)
    except InputError:
        return False
    return True


def _read_sector(values: dict[str, Any], folder: Path | None) -> None:
    """Put the sector of a file in the place of its name: an experiment is whole by itself."""
    task = values.get("task")
    if isinstance(task, dict) and isinstance(task.get("sector"), str):
        with error_context("task.sector"):
            task["sector"] = msgspec.to_builtins(named_or_read(task["sector"], folder))


def experiment_from(values: Mapping[str, Any], where: str) -> Experiment:
    """Check plain values (from TOML or from a policy) and make an experiment of them."""
    _check_keys(values, Experiment, where, "")
    with error_context(where):
        experiment: Experiment = convert(values, _ENTRIES)
    build_task(experiment.task)
    ppo = experiment.ppo
    if ppo.minibatch > ppo.samples:
        raise InputError(
            f"{where}: ppo.minibatch is {ppo.minibatch} (allowed: at most ppo.environments * "
            f"ppo.steps, {ppo.samples})"
        )
    return experiment


def resolved(experiment: Experiment) -> dict[str, Any]:
    """The experiment with every default as plain values; what is absent is left out."""
    values: dict[str, Any] = _without_absent(msgspec.to_builtins(experiment))
    return values


def _without_absent(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {key: _without_absent(inner) for key, inner in value.items() if inner is not None}


def to_toml(experiment: Experiment) -> bytes:
    """The experiment fully resolved."""
    return tomli_w.dumps(resolved(experiment)).encode()


def _set(values: dict[str, Any], change: str) -> None:
    """Apply one `table.key=value`; the value is TOML, or a bare word."""
    key, equals, text = change.partition("=")
    if not change.isprintable():
        raise InputError(f"--set {change!r} is not one printable line")
    if not equals or not key.strip():
        raise InputError(
            f"--set {change!r} is not of the form key=value (as ppo.total_steps=500000)"
        )
    try:
        value = parse_toml(f"value = {text}".encode())["value"]
    except InputError:
        value = text.strip()
    *tables, last = key.strip().split(".")
    for table in tables:
        inner = values.setdefault(table, {})
        if not isinstance(inner, dict):
            raise InputError(f"--set {change!r}: {table!r} is a value, not a table")
        values = inner
    values[last] = value


def _check_keys(values: Mapping[str, Any], kind: type, where: str, path: str) -> None:
    """Name an unknown key with the nearest one, before anything is converted."""
    fields = {field.name: field.type for field in msgspec.structs.fields(kind)}
    for key, value in values.items():
        full = f"{path}{key}"
        if key not in fields:
            elsewhere = [known for known in _all_keys() if known.endswith(f".{key}")]
            error = unknown_name("key", full, elsewhere or [path + name for name in fields])
            raise InputError(f"{where}: {error}")
        inner = Pretraining if key == "pretraining" else fields[key]
        if isinstance(inner, type) and issubclass(inner, msgspec.Struct):
            if not isinstance(value, Mapping):
                raise InputError(f"{where}: {full} is a value (allowed: a table)")
            _check_keys(value, inner, where, f"{full}.")


def _all_keys() -> list[str]:
    """Of every table, in full."""
    tables = {"task": TaskSettings, "ppo": PPOSettings, "pretraining": Pretraining}
    tables |= {"task.reward": RewardSettings, "pretraining.reward": RewardSettings}
    return [f"{table}.{name}" for table, kind in tables.items() for name in kind.__struct_fields__]
