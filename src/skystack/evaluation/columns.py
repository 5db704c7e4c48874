"""Allowed types and values of table columns, checked on reading, because tables are untrusted."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skystack.errors import InputError

MAX_ROWS = 20_000_000
MAX_KEPT_ROWS = 1_000_000
"""The maximum number of rows after filtering."""
MAX_GROUP_BYTES = 500_000_000
"""The maximum size of a row group, as stated in the file."""
MAX_TEXT_BYTES = 100_000_000
"""The maximum size of a decoded column: a few bytes can encode a long text for every row."""
GREATEST = 1e9
"""The largest number in a column, unless `GREATEST_DEGREES` states another."""
GREATEST_DEGREES = {"lat": 89.9999, "lon": 360.0}
"""The projection is undefined at the poles."""

TEXT = {"callsign", "type", "route", "status", "kind", "direction", "text"}
TRUTH = {"success", "correct_exit", "excursion", "few_clearances", "loss_of_separation"}
TRUTH |= {"own_navigation"}
WHOLE = {"scenario", "cycle", "cycles", "time_s", "clearances", "instructions", "transmission"}
WHOLE |= {"value", "exit_fl", "exits", "birth_cycle"}
"""Counts, identifying numbers and cleared values, which are not negative."""
MAY_BE_NULL = {"direction", "exit_offset_nm", "gone_cycle"}
MAY_BE_INFINITE = {"min_separation_nm"}


class _Kind(NamedTuple):
    words: str
    fits: Callable[[pa.DataType], bool]


_TEXT = _Kind("text", lambda kind: pa.types.is_string(kind) or pa.types.is_large_string(kind))
_TRUTH = _Kind("true or false", pa.types.is_boolean)
_WHOLE = _Kind("whole numbers", pa.types.is_integer)
_NUMBER = _Kind(
    "numbers",
    lambda kind: (
        pa.types.is_integer(kind) or pa.types.is_float32(kind) or pa.types.is_float64(kind)
    ),
)


def check_columns(table: pa.Table) -> None:
    """Raise InputError that names a column of a wrong type or with values that are not allowed."""
    try:
        table.validate(full=True)
    except pa.ArrowException as error:
        raise InputError(f"damaged: {error}") from None
    for name in table.column_names:
        _check_column(name, table[name])


def _check_column(name: str, column: pa.ChunkedArray) -> None:
    if not len(column):  # an empty column may have any type
        return
    wanted = _kind_of(name)
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    if not wanted.fits(kind):
        raise InputError(f"column {name!r} holds {kind} (allowed: {wanted.words})")
    if column.null_count and name not in MAY_BE_NULL:
        raise InputError(f"column {name!r} is empty in {column.null_count} rows")
    if pa.types.is_dictionary(column.type) and _text_bytes(column) > MAX_TEXT_BYTES:
        raise InputError(f"column {name!r} holds too much text (allowed: {MAX_TEXT_BYTES} bytes)")
    if wanted in (_WHOLE, _NUMBER):
        greatest = GREATEST_DEGREES.get(name, GREATEST)
        lowest = 0.0 if wanted is _WHOLE else -greatest
        _check_range(name, column.drop_null().to_numpy(), lowest, greatest)


def _text_bytes(column: pa.ChunkedArray) -> int:
    """The size of all rows together; a repeated text counts in each row."""
    return sum(
        pc.sum(pc.binary_length(chunk.dictionary).take(chunk.indices)).as_py() or 0
        for chunk in column.chunks
    )


def _check_range(name: str, values: np.ndarray, lowest: float, greatest: float) -> None:
    known = values[values != np.inf] if name in MAY_BE_INFINITE else values
    if not np.all((known >= lowest) & (known <= greatest)):  # true of NaN too
        raise InputError(
            f"column {name!r} contains a value out of range "
            f"(allowed: finite numbers from {lowest:g} to {greatest:g})"
        )


def _kind_of(name: str) -> _Kind:
    if name in TEXT:
        return _TEXT
    if name in TRUTH:
        return _TRUTH
    return _WHOLE if name in WHOLE else _NUMBER
