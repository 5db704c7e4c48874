"""Finished hours on disk."""

import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from skystack.evaluation.controllers import find_controller
from skystack.evaluation.flown_seeds import FlownSeed, conditions_digest, read_seed, write_seed
from skystack.evaluation.hour_scores import CycleSeries, FlightRow, PairEvent, Scores
from skystack.evaluation.hour_tables import TABLES
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.export.onnx_file import export_onnx
from skystack.io.files import file_digest
from skystack.policies.shipped import SHIPPED, find_policy

SCORES = Scores(
    number=7,
    cycles=CycleSeries(
        np.array([0, 2]), np.array([3, 4]), np.array([0, 1]), np.array([True, False]),
        np.array([0.25, 1e-3]),
    ),
    flights=[FlightRow(0, 1, None, True, False, False, float("nan"), 9.5, float("nan"), 2.0, 1, 2)],
    losses=[PairEvent(3, 0, 1, True, None)],
    close_pairs=[],
    lax_s=600.0,
    lax_without_births_s=606.0,
    strict_s=600.0,
    lax_ended_by="loss",
    strict_ended_by=None,
)  # fmt: skip
TABLE = pa.table({"scenario": [7, 7], "text": ["a", None]})
FLOWN = FlownSeed(SCORES, dict.fromkeys(TABLES, TABLE))


def test_what_is_written_is_read(tmp_path):
    write_seed(tmp_path, 7, "conditions", FLOWN)
    read = read_seed(tmp_path, 7, "conditions")
    assert read.tables == FLOWN.tables
    for one, other in zip(read.scores.cycles, SCORES.cycles, strict=True):
        np.testing.assert_array_equal(one, other)
    (flight,), (expected,) = read.scores.flights, SCORES.flights
    np.testing.assert_equal(tuple(flight), tuple(expected))
    assert read.scores[3:] == SCORES[3:]


def test_other_conditions_and_seeds_are_not_read(tmp_path):
    write_seed(tmp_path, 7, "conditions", FLOWN)
    assert read_seed(tmp_path, 7, "others") is None
    assert read_seed(tmp_path, 8, "conditions") is None
    (path,) = tmp_path.iterdir()
    path.rename(tmp_path / "seed-8.hour")
    assert read_seed(tmp_path, 8, "conditions") is None


@pytest.mark.parametrize("at", [0, 40, 200, -1])
def test_a_damaged_file_is_not_read(tmp_path, at):
    write_seed(tmp_path, 7, "conditions", FLOWN)
    (path,) = tmp_path.iterdir()
    data = bytearray(path.read_bytes())
    data[at] ^= 1
    path.write_bytes(data)
    assert read_seed(tmp_path, 7, "conditions") is None
    path.write_bytes(data[:50])
    assert read_seed(tmp_path, 7, "conditions") is None
    path.write_bytes(b"")
    assert read_seed(tmp_path, 7, "conditions") is None


def test_the_digest_depends_on_all_conditions(tmp_path):
    base = TrafficConditions("category")
    changed = [
        base,
        base._replace(traffic="60"),
        base._replace(cycles=60),
        base._replace(uncertainty=True),
        base._replace(per_cycle=1),
        base._replace(platform="bluebird"),
        base._replace(sector="crossing"),
    ]
    digests = [conditions_digest(find_controller("rules", each), each) for each in changed]
    digests.append(conditions_digest(find_controller("no-op", base), base))
    assert len(set(digests)) == len(digests)
    again = base._replace(seed=5, hours=9)  # neither changes the hour of a seed
    assert conditions_digest(find_controller("rules", again), again) == digests[0]


def test_the_digest_depends_on_the_contents_of_a_scenario_file(tmp_path):
    path = tmp_path / "head-on.json"
    text = Path("examples/head-on.json").read_text()
    digests = []
    for changed in (text, text.replace('"cycles": 150', '"cycles": 151'), text):
        path.write_text(changed)
        conditions = TrafficConditions(str(path), cycles=100)
        digests.append(conditions_digest(find_controller("rules", conditions), conditions))
    assert digests[0] == digests[2] != digests[1]


def test_the_digest_depends_on_the_folder_of_a_users_controller(tmp_path):
    digests, conditions = [], TrafficConditions("category")
    for folder in ("one", "two"):  # they may import other modules
        (tmp_path / folder).mkdir()
        file = tmp_path / folder / "own.py"
        file.write_text("from elsewhere import Controller")
        found = find_controller(f"{file}:Controller", conditions)
        digests.append(conditions_digest(found, conditions))
    assert digests[0] != digests[1]


def test_a_seed_is_not_read_if_a_file_of_the_controller_has_changed(tmp_path):
    files = {}
    for name in ("own.py", "part.py"):
        (tmp_path / name).write_text(name)
        files[str(tmp_path / name)] = file_digest(tmp_path / name)
    write_seed(tmp_path, 7, "conditions", FLOWN._replace(files=files))
    assert read_seed(tmp_path, 7, "conditions").files == files
    (tmp_path / "part.py").write_text("changed")
    assert read_seed(tmp_path, 7, "conditions") is None
    (tmp_path / "part.py").write_text("part.py")
    assert read_seed(tmp_path, 7, "conditions") is not None
    (tmp_path / "part.py").unlink()
    assert read_seed(tmp_path, 7, "conditions") is None


def test_a_run_folder_may_be_named_like_a_class(tmp_path):
    folder = tmp_path / "runs:mine"
    shutil.copytree(SHIPPED / "sector-control", folder)
    assert find_controller(str(folder), TrafficConditions("category")).name == "sector-control-s0"


@pytest.mark.parametrize("name", ["no-op", "mvp"])
def test_a_policy_file_is_not_taken_for_a_controller_of_the_same_name(tmp_path, name):
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    file = tmp_path / f"{name}.onnx"
    export_onnx(find_policy("sector-control"), file)
    found = find_controller(str(file), TrafficConditions("category"))
    assert found.name == f"{name}.onnx"
