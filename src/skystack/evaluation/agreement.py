"""Agreement of two evaluations of the same scenarios: same clearances in the same order."""

from collections import defaultdict
from collections.abc import Iterable

import pyarrow as pa

IssuedRow = tuple[int, str, str, int]
"""Cycle, callsign, kind, value."""


def same_clearances(
    ours: pa.Table, theirs: pa.Table, scenarios: Iterable[int], cycles: int = 1
) -> list[bool]:
    """For each scenario, whether both tables `clearances` agree on it.

    They agree if they have the same aircraft, kinds and values in the same order, each at most
    `cycles` cycles apart.
    """
    first, second = _by_scenario(ours), _by_scenario(theirs)
    return [_agree(first[number], second[number], cycles) for number in scenarios]


def _by_scenario(table: pa.Table) -> defaultdict[int, list[IssuedRow]]:
    rows: defaultdict[int, list[IssuedRow]] = defaultdict(list)
    columns = (
        table[name].to_pylist() for name in ("scenario", "cycle", "callsign", "kind", "value")
    )
    for scenario, *clearance in zip(*columns, strict=True):
        rows[scenario].append(tuple(clearance))
    return rows


def _agree(ours: list[IssuedRow], theirs: list[IssuedRow], cycles: int) -> bool:
    return len(ours) == len(theirs) and all(
        a[1:] == b[1:] and abs(a[0] - b[0]) <= cycles for a, b in zip(ours, theirs, strict=True)
    )
