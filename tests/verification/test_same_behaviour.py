"""The results of two installations are compared part by part."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from verification.robustness.same_behaviour import _parts, commands, different


def test_names_only_the_parts_that_differ():
    first = {"a": "1", "b": "2", "c": "3"}
    assert different(first, first) == []
    assert different(first, {"a": "1", "b": "9", "d": "4"}) == ["b", "c", "d"]


def test_compares_tables_by_column_and_accepts_old_names(tmp_path):
    paths = [tmp_path / "old.parquet", tmp_path / "new.parquet"]
    for path, status, lat in zip(paths, ("strayed", "excursion"), (1.0, 1.0 + 2**-52), strict=True):
        pq.write_table(pa.table({"status": [status], "lat": np.array([lat])}), path)
    old, new = (dict(_parts(path)) for path in paths)
    assert different(old, new) == ["lat"]


def test_ignores_times(tmp_path):
    digests = []
    for wall_s, loss in ((1.0, 0.5), (2.0, 0.5), (1.0, 0.25)):
        path = tmp_path / "metrics.jsonl"
        path.write_text(json.dumps({"update": 1, "wall_s": wall_s, "policy_loss": loss}) + "\n")
        digests.append(dict(_parts(path)))
    assert digests[0] == digests[1] != digests[2]


def test_compares_shipped_policies_and_experiments(tmp_path):
    lines = [" ".join(command) for command in commands(tmp_path, 10, 100)]
    assert sum(line.startswith("evaluate lateral-best ") for line in lines) == 3
    assert any(line.startswith("train avoidance-best ") for line in lines)
