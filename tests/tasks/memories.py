"""Memories of tasks with some fields changed, whichever part they are in."""


def changed(memory, **fields):
    """The memory with fields of its parts replaced, by name."""
    parts = {
        name: part._replace(**{key: fields.pop(key) for key in part._fields if key in fields})
        for name, part in memory._asdict().items()
    }
    assert not fields, f"no part of the memory has {fields}"
    return type(memory)(**parts)
