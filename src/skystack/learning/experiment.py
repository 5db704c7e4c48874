"""Experiments by name or from a TOML file, with `--set` changes. All keys are checked."""

from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from importlib.resources import files
from os import fspath
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from skystack.airspace.sectors import sector_setting
from skystack.errors import InputError, error_context, unknown_name
from skystack.io.files import AnyPath, read_whole
from skystack.io.json_file import MAX_BYTES
from skystack.io.names import Name
from skystack.io.toml_file import parse_toml
from skystack.io.validation import convert, not_allowed
from skystack.learning.settings import PPOSettings, Pretraining
from skystack.tasks.kinds import TaskKind
from skystack.tasks.registry import build_task, find_task, tasks
from skystack.tasks.settings import NavigationSettings, TaskSettings

_FOLDER = files("skystack").joinpath("experiments")


class Experiment(msgspec.Struct, frozen=True):
    """An experiment: a task and the settings of its training."""

    name: Name
    description: str = ""
    task: TaskSettings = NavigationSettings()
    """The settings of the task, of the type that its `TaskKind` defines."""
    ppo: PPOSettings = PPOSettings()
    pretraining: Pretraining | None = None


def experiment_names() -> list[str]:
    """The names of the experiments in the package."""
    names = (entry.name for entry in _FOLDER.iterdir())
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml"))


def load_experiment(name: AnyPath, changes: Iterable[str] = ()) -> Experiment:
    """The experiment with the given name or from a `.toml` file, with `key=value` changes.

    Raises InputError for an unknown name or key, or a value of the wrong type or out of range.

    Example:

        >>> import skystack
        >>> experiment = skystack.load_experiment("lateral", ["ppo.total_steps=500_000"])
        >>> experiment.ppo.total_steps
        500000
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
    unchanged = deepcopy(values)
    for change in changes:
        _set(values, change)
    _read_sector(values, None)
    try:
        return experiment_from(values, where)
    except InputError as error:
        if not changes or not _is_valid(unchanged, where):
            raise
        raise InputError(str(error).replace(f"{where}: ", "--set: ", 1)) from None


def _is_valid(values: Mapping[str, Any], where: str) -> bool:
    try:
        experiment_from(values, where)
    except InputError:
        return False
    return True


def _read_sector(values: dict[str, Any], folder: Path | None) -> None:
    """Replace the name of a sector file with its contents, so the experiment is self-contained."""
    task = values.get("task")
    if isinstance(task, dict) and isinstance(task.get("sector"), str):
        with error_context("task.sector"):
            task["sector"] = msgspec.to_builtins(sector_setting(task["sector"], folder))


def experiment_from(values: Mapping[str, Any], where: str) -> Experiment:
    """The experiment of plain values (from TOML or from a policy).

    Raises InputError, prefixed with `where`, if any key or value is invalid.
    """
    with error_context(where):
        values = _with_current_names(values)
        kind = _kind_of(values)
        _check_keys(values, _tables(kind))
        experiment = _converted(values, kind)
        build_task(experiment.task)
        ppo = experiment.ppo
        if ppo.minibatch > ppo.samples:
            raise InputError(
                f"ppo.minibatch is {ppo.minibatch} (allowed: at most ppo.environments * "
                f"ppo.steps, {ppo.samples})"
            )
    return experiment


def _kind_of(values: Mapping[str, Any]) -> TaskKind:
    """The kind of the named task, or of the default task if none is named."""
    task = values.get("task")
    name = task.get("name") if isinstance(task, Mapping) else None
    if name is not None and not isinstance(name, str):
        raise not_allowed("task.name", name, ", ".join(tasks()))
    with error_context("task.name"):
        return find_task(TaskSettings().name if name is None else name)


def _converted(values: Mapping[str, Any], kind: TaskKind) -> Experiment:
    """The experiment, converted table by table, because the fields depend on the task's name."""
    other = {key: value for key, value in values.items() if key not in ("task", "pretraining")}
    experiment: Experiment = convert(other, Experiment)
    tables: dict[str, Any] = {}
    with error_context("task", "."):
        tables["task"] = convert(values.get("task", {}), kind.settings)
    if "pretraining" in values:
        with error_context("pretraining", "."):
            pretraining: Pretraining = convert(values["pretraining"], Pretraining)
        reward, reward_type = pretraining.reward, _reward_type(kind)
        with error_context("pretraining.reward", "."):
            reward = convert({} if reward is None else reward, reward_type)
        tables["pretraining"] = msgspec.structs.replace(pretraining, reward=reward)
    return msgspec.structs.replace(experiment, **tables)


def _reward_type(kind: TaskKind) -> Any:
    """The type of the task's `reward` table. Raises InputError if the task has none."""
    for field in msgspec.structs.fields(kind.settings):
        if field.name == "reward":
            return field.type
    raise InputError(f"pretraining is not possible: task {kind.name} has no table reward")


_OLD_REWARDS = {"stray": "excursion"}
"""Current names of rewards by their names in files of older versions."""


def _with_current_names(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values, with the keys of older versions renamed."""
    renamed = deepcopy(dict(values))
    for name in ("task", "pretraining"):
        table = renamed.get(name)
        reward = table.get("reward") if isinstance(table, dict) else None
        if isinstance(reward, dict):
            for old, new in _OLD_REWARDS.items():
                if old in reward and new not in reward:
                    reward[new] = reward.pop(old)
    return renamed


def resolved(experiment: Experiment) -> dict[str, Any]:
    """The experiment as plain values, including all defaults. Values of None are omitted."""
    values: dict[str, Any] = _without_none(msgspec.to_builtins(experiment))
    return values


def _without_none(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {key: _without_none(inner) for key, inner in value.items() if inner is not None}


def to_toml(experiment: Experiment) -> bytes:
    """The fully resolved experiment as TOML."""
    return tomli_w.dumps(resolved(experiment)).encode()


def _set(values: dict[str, Any], change: str) -> None:
    """Apply one change `table.key=value`. The value is TOML or a bare word."""
    key, equals, text = change.partition("=")
    if not change.isprintable():
        raise InputError(f"--set {change!r} is not one printable line")
    if not equals or not key.strip():
        raise InputError(
            f"--set {change!r} is not of the form key=value (example: ppo.total_steps=500000)"
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


def _tables(kind: TaskKind) -> dict[str, Sequence[str]]:
    """The keys of each table of an experiment, by the table's name; "" is the top level."""
    keys: dict[str, Sequence[str]] = {
        "": Experiment.__struct_fields__,
        "task": kind.settings.__struct_fields__,
        "ppo": PPOSettings.__struct_fields__,
        "pretraining": Pretraining.__struct_fields__,
    }
    if "reward" in kind.settings.__struct_fields__:
        keys["task.reward"] = keys["pretraining.reward"] = _reward_type(kind).__struct_fields__
    return keys


def _check_keys(values: Mapping[str, Any], tables: Mapping[str, Sequence[str]]) -> None:
    """Raise InputError for an unknown key, before any value is converted.

    The message suggests the nearest known key, also from other tables.
    """
    for table, keys in tables.items():
        contents: Any = values
        for step in table.split(".") if table else ():
            contents = contents.get(step) if isinstance(contents, Mapping) else None
        if contents is None:
            continue
        if not isinstance(contents, Mapping):
            raise InputError(f"{table} is a value (allowed: a table)")
        for key in contents:
            if key not in keys:
                raise _unknown_key(table, str(key), tables)


def _unknown_key(table: str, key: str, tables: Mapping[str, Sequence[str]]) -> InputError:
    all_keys = [f"{name}.{each}" for name, keys in tables.items() if name for each in keys]
    same_name = [known for known in all_keys if known.endswith(f".{key}")]
    full = f"{table}.{key}" if table else key
    same_table = [f"{table}.{name}" if table else name for name in tables[table]]
    return unknown_name("key", full, same_name or same_table)
