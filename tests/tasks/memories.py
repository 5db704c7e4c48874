"""Replacing fields of a task's memory, whichever part they are in."""


def with_fields(memory, **fields):
    """A copy of the memory with the named fields replaced."""
    parts = {
        name: part._replace(**{key: fields.pop(key) for key in part._fields if key in fields})
        for name, part in memory._asdict().items()
    }
    assert not fields, f"no part of the memory has {fields}"
    return type(memory)(**parts)
