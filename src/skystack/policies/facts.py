"""The metadata of an exported policy, under the names of `policy.json`."""

from collections.abc import Mapping
from typing import Any

import msgspec

from skystack.errors import InputError, error_context
from skystack.io.names import Name, Seed
from skystack.io.validation import convert
from skystack.learning.policy import Policy, PolicyDescription
from skystack.tasks.contract import Task


class Facts(msgspec.Struct, frozen=True):
    """The part of a policy's description that is included in an export."""

    experiment: Name
    seed: Seed
    task_name: str
    task_version: int
    observation: tuple[str, ...]
    actions: tuple[str, ...]
    sha256: str
    """The hash of `policy.safetensors`."""


def facts(policy: Policy) -> dict[str, Any]:
    """The metadata of a policy: integers, strings and tuples of strings."""
    return {name: getattr(policy.description, name) for name in Facts.__struct_fields__}


def check_trained_for(task: Task, described: PolicyDescription | Facts, where: str) -> None:
    """Raise InputError, prefixed with `where`, unless a policy was trained for a task as it is."""
    if (described.task_name, described.task_version) != (task.name, task.version):
        raise InputError(
            f"{where} was trained for task {described.task_name} version "
            f"{described.task_version} (allowed: {task.name} version {task.version}); "
            "train it again"
        )
    if described.observation != task.observation_names or described.actions != task.action_names:
        raise InputError(f"{where}: its observation or actions differ from those of its task")


def facts_as_texts(policy: Policy) -> dict[str, str]:
    """The metadata for formats that store strings only. Values of other types become JSON."""
    return {
        name: value if isinstance(value, str) else msgspec.json.encode(value).decode()
        for name, value in facts(policy).items()
    }


def facts_from_texts(texts: Mapping[str, str]) -> Facts | None:
    """The metadata among the strings of a file, or None if skystack did not export the file.

    Raises InputError if the metadata is damaged.
    """
    fields = msgspec.structs.fields(Facts)
    if any(field.name not in texts for field in fields):
        return None
    values: dict[str, Any] = {}
    for field in fields:
        text = texts[field.name]
        try:
            values[field.name] = text if field.type in (str, Name) else msgspec.json.decode(text)
        except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
            raise InputError(f"{field.name} in its metadata is damaged: {error}") from None
    with error_context("its metadata is damaged"):
        return convert(values, Facts)
