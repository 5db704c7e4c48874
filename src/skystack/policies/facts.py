"""What an exported policy says about itself, under the names of `policy.json`."""

from collections.abc import Mapping
from typing import Any

import msgspec

from skystack.errors import InputError
from skystack.io.names import Name, Seed, in_words
from skystack.learning.policy import Policy


class Facts(msgspec.Struct, frozen=True):
    """The part of a policy's description that travels with an export."""

    experiment: Name
    seed: Seed
    task_name: str
    task_version: int
    observation: tuple[str, ...]
    actions: tuple[str, ...]
    sha256: str
    """Of `policy.safetensors`."""


def facts(policy: Policy) -> dict[str, Any]:
    """What a policy is, sees and means by its outputs: numbers, texts, tuples of texts."""
    return {name: getattr(policy.description, name) for name in Facts.__struct_fields__}


def facts_as_texts(policy: Policy) -> dict[str, str]:
    """The same for formats that hold texts only: what is no text is written as JSON."""
    return {
        name: value if isinstance(value, str) else msgspec.json.encode(value).decode()
        for name, value in facts(policy).items()
    }


def facts_from_texts(texts: Mapping[str, str]) -> Facts | None:
    """The facts among the texts of a file; None where it is no export of ours.

    Raises InputError where they are damaged.
    """
    fields = msgspec.structs.fields(Facts)
    if any(field.name not in texts for field in fields):
        return None
    values: dict[str, Any] = {}
    for field in fields:
        text = texts[field.name]
        try:
            plain = text if field.type in (str, Name) else msgspec.json.decode(text)
            values[field.name] = msgspec.convert(plain, field.type)
        except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
            damaged = f"{field.name} in its metadata is damaged: {in_words(str(error))}"
            raise InputError(damaged) from None
    return Facts(**values)
