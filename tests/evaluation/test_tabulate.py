"""Tables are written while scenarios are flown, and do not depend on the size of the blocks."""

from functools import partial

import numpy as np
import pyarrow.parquet as pq
import pytest

from skystack.errors import InputError
from skystack.evaluation import evaluate, rollout, writing
from skystack.evaluation.evaluate import Conditions, policy_task
from skystack.evaluation.rollout import (
    NO_OP_CONTROLLER,
    concatenate,
    fly,
    network_controller,
    parts_of,
    prepare,
)
from skystack.evaluation.summary import evaluation_folder
from skystack.evaluation.tables import make_tables
from skystack.evaluation.tabulate import TABLES, tabulate
from skystack.evaluation.writing import EVALUATION
from skystack.io.locks import LOCK
from skystack.policies.shipped import find_policy
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

SCENARIOS = 20


@pytest.fixture(scope="module")
def task():
    return policy_task(find_policy("lateral-best"))


@pytest.fixture(scope="module")
def fly_blocks(task):
    """A function that flies scenarios of a seed in blocks; compiled once per size of block."""
    policy = find_policy("lateral-best")
    controller = network_controller(policy.actor, policy.normaliser, greedy=True)
    return partial(prepare(task, controller.decide, stacking=True), controller.weights)


@pytest.fixture(scope="module")
def flown(fly_blocks):
    return concatenate(list(fly_blocks(0, SCENARIOS)))


def blocks_of(flown, scenarios):
    return iter(list(parts_of(flown, scenarios)))


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 7])
def test_tables_do_not_depend_on_the_blocks(size, task, flown, tmp_path, monkeypatch):
    """Byte for byte, and they equal the tables of all scenarios at once."""
    monkeypatch.setattr(writing, "GROUP_ROWS", 1000)
    expected = make_tables(task, flown)
    for name, scenarios in (("whole", SCENARIOS), ("parts", size)):
        kept = tabulate(task, blocks_of(flown, scenarios), tmp_path / name)
        assert kept.episodes.equals(expected.episodes)
        assert kept.clearances.cast(expected.clearances.schema).equals(expected.clearances)
    for name in TABLES:
        whole, parts = (tmp_path / each / f"{name}.parquet" for each in ("whole", "parts"))
        assert pq.read_table(parts).equals(getattr(expected, name))
        assert parts.read_bytes() == whole.read_bytes()


@pytest.mark.slow
def test_without_a_folder_the_result_is_the_same(task, flown, tmp_path):
    in_memory, written = (
        tabulate(task, blocks_of(flown, 8), folder) for folder in (None, tmp_path / "tables")
    )
    assert in_memory.episodes.equals(written.episodes)
    assert in_memory.clearances.equals(written.clearances)


def test_long_scenarios_are_flown_in_smaller_blocks():
    long = build_task(NavigationSettings(cycles=10_000))
    sizes = [len(numbers) for numbers in rollout.blocks(long, 100)]
    assert sizes == [30, 30, 30, 10]
    assert [len(numbers) for numbers in rollout.blocks(build_task(NavigationSettings()), 1001)] == [
        1000,
        1,
    ]


@pytest.mark.slow
def test_an_evaluation_does_not_depend_on_its_blocks(fly_blocks, tmp_path, monkeypatch):
    """The row, the results in memory and the files, byte for byte, in one block and in two."""
    monkeypatch.setattr(
        evaluate, "prepare", lambda *_: lambda _, *arguments: fly_blocks(*arguments)
    )
    policy, finished, found = find_policy("lateral-best"), [], []
    for most in (SCENARIOS, SCENARIOS // 2):
        monkeypatch.setattr(rollout, "SCENARIOS_AT_ONCE", most)
        conditions, out = Conditions(episodes=SCENARIOS), tmp_path / str(most)
        evaluated = evaluate.evaluate(policy, conditions, out, finished.append)
        folder = evaluation_folder(out, "lateral-best", evaluated.row["seed"], stacking=True)
        files = {path.name: path.read_bytes() for path in folder.iterdir()}
        found.append(
            (evaluated.row | {"wall_s": 0.0}, evaluated.episodes, evaluated.clearances, files)
        )
    assert finished == [0, SCENARIOS, 0, SCENARIOS // 2, SCENARIOS]
    assert found[0] == found[1]
    assert files.keys() == {LOCK, *(f"{name}.parquet" for name in TABLES)}


@pytest.mark.parametrize("error", [KeyboardInterrupt, InputError("no action")])
@pytest.mark.parametrize("before", [0, 1])
def test_an_interrupted_evaluation_leaves_old_tables_unchanged(
    error, before, task, flown, tmp_path
):
    def broken():
        yield from list(parts_of(flown, 10))[:before]
        raise error

    folder = tmp_path / "tables"
    for old in (False, True):
        if old:
            tabulate(task, blocks_of(flown, 10), folder)
        names = {f"{name}.parquet" for name in TABLES} if old else set()
        kept = {name: (folder / name).read_bytes() for name in names}
        with pytest.raises(error if isinstance(error, type) else type(error)):
            tabulate(task, broken(), folder)
        left = {path.name for path in folder.glob("*")}
        assert left - {LOCK} == names
        assert all((folder / name).read_bytes() == data for name, data in kept.items())


@pytest.mark.slow
def test_without_instructions_the_clearances_table_is_empty(tmp_path):
    task = build_task(NavigationSettings(cycles=4))
    kept = tabulate(task, blocks_of(fly(task, NO_OP_CONTROLLER, 0, 3, False), 2), tmp_path)
    assert kept.clearances.num_rows == 0
    stored = pq.read_table(tmp_path / "clearances.parquet")
    assert (stored.num_rows, stored.schema.names) == (0, kept.clearances.schema.names)
    np.testing.assert_array_equal(kept.episodes["scenario"], [0, 1, 2])


def test_tables_of_one_evaluation_have_the_same_digest(tmp_path):
    """It depends on the evaluation, not on the size of its blocks."""
    task = build_task(NavigationSettings("lateral"))
    found = []
    for name, seed, size in (("one", 0, 3), ("parts", 0, 2), ("other", 1, 3)):
        tabulate(
            task, blocks_of(fly(task, NO_OP_CONTROLLER, seed, 3, False), size), tmp_path / name
        )
        tables = [pq.read_metadata(tmp_path / name / f"{table}.parquet") for table in TABLES]
        (digest,) = {table.metadata[EVALUATION] for table in tables}
        found.append(digest)
    assert found[0] == found[1] != found[2]
