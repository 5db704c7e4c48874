"""Turn blocks of flown scenarios into tables; write them block by block if a folder is given."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from skystack.evaluation.exit_offset import exit_offsets_nm
from skystack.evaluation.rollout import Recording, parts_of, scenarios_in_part
from skystack.evaluation.tables import Tables, clearance_table, episode_table, make_tables
from skystack.evaluation.writing import Append, growing_tables, table_metadata
from skystack.io.locks import locked_folder
from skystack.platforms.adoption import SKYSTACK, Adoption
from skystack.tasks.contract import TrafficTask

TABLES = tuple(field.name for field in fields(Tables))


class Tabulated(NamedTuple):
    """The tables kept in memory for all scenarios: aircraft and trajectories would be too large."""

    episodes: pa.Table
    clearances: pa.Table
    """Texts are dictionary-encoded."""
    flying_s: float
    """The time spent flying."""


def tabulate(
    task: TrafficTask,
    blocks: Iterator[Recording],
    folder: Path | None,
    flown_as: Callable[[str], str] = str,
    adoption: Adoption = SKYSTACK,
) -> Tabulated:
    """Make the tables of one or more blocks. If a folder is given, write all four or none to it.

    The tables do not depend on how scenarios are divided into blocks. Raises what flying raises,
    and InputError for a folder that cannot be written to or is in use by another process.
    """
    episodes, clearances = list[pa.Table](), list[pa.Table]()
    flying_s, started_s = 0.0, time.monotonic()
    with ExitStack() as stack:
        append: Append | None = None
        for block in blocks:
            flying_s += time.monotonic() - started_s
            if folder is not None and append is None:  # only now: an early failure leaves no files
                append = stack.enter_context(_tables_in(folder, task))
            for part in parts_of(block, scenarios_in_part(task)):
                outcomes, issued = _tables_of(task, part, append, flown_as, adoption)
                episodes.append(outcomes)
                clearances.append(issued)
            del block, part  # free the memory before the next block is flown
            started_s = time.monotonic()
        flying_s += time.monotonic() - started_s
    return Tabulated(
        pa.concat_tables(episodes).combine_chunks(),
        pa.concat_tables(clearances).unify_dictionaries(),
        flying_s,
    )


@contextmanager
def _tables_in(folder: Path, task: TrafficTask) -> Iterator[Append]:
    metadata = table_metadata(task.sector, task.performance, task.fleet)
    with locked_folder(folder), growing_tables(folder, TABLES, metadata) as append:
        yield append


def _tables_of(
    task: TrafficTask,
    part: Recording,
    append: Append | None,
    flown_as: Callable[[str], str],
    adoption: Adoption,
) -> tuple[pa.Table, pa.Table]:
    """The episodes and clearances of some scenarios. If tables are written, appends all four."""
    if append is None:
        episodes = episode_table(task, part, exit_offsets_nm(task.sector, part))
        clearances = clearance_table(task, part, adoption)
    else:
        tables = make_tables(task, part, flown_as, adoption)
        append(vars(tables))
        episodes, clearances = tables.episodes, tables.clearances
    return _copied(episodes), _copied(_with_dictionaries(clearances))


def _copied(table: pa.Table) -> pa.Table:
    """A compact copy: holding on to arrays of a block would fragment memory."""
    return table.take(pa.array(np.arange(table.num_rows)))


def _with_dictionaries(table: pa.Table) -> pa.Table:
    """The same table with repeated texts stored once (dictionary encoding)."""
    for index, field in enumerate(table.schema):
        if pa.types.is_string(field.type):
            table = table.set_column(index, field.name, table[field.name].dictionary_encode())
    return table
