"""`skystack export` of policies: the files give the policy's answers in other programs."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from skystack.errors import InputError
from skystack.export import onnx_file
from skystack.export.formats import export
from skystack.policies.shipped import SHIPPED, find_policy
from tests.scenarios import EXAMPLES

DOCS = Path(__file__).parents[2] / "docs"
POLICIES = ["lateral", "lateral-large", "avoidance-best", "vertical"]
"""Two aircraft with few and with many actions, two that observe each other, and a single one."""
SAMPLES = 10_000


def observations(policy):
    """In [0, 1], as in tasks, outside of it, and far outside the limits of the normaliser."""
    rng = np.random.default_rng(0)
    observed = rng.uniform(size=(SAMPLES, len(policy.description.observation)))
    observed[: SAMPLES // 2] = 5.0 * observed[: SAMPLES // 2] - 2.0
    observed[: SAMPLES // 4] *= 1e6
    return observed.astype(np.float32)


@pytest.mark.parametrize("name", POLICIES)
def test_an_onnx_session_gives_the_same_answers_as_the_policy(name, tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime")
    policy, target = find_policy(name), tmp_path / "policy.onnx"
    assert export(name, "onnx", None, target) == []
    session = onnxruntime.InferenceSession(target)
    observed = observations(policy)
    logits, action = session.run(["logits", "action"], {"observation": observed})
    expected = policy.logits(observed)
    # Float32 sums of 64 terms in any order, in three layers.
    rounding = 1e-5 * np.abs(expected).max(axis=1, keepdims=True)
    assert np.all(np.abs(logits - expected) <= rounding)
    chosen = np.take_along_axis(expected, action[:, None], axis=1)
    assert np.all(chosen >= expected.max(axis=1, keepdims=True) - 2.0 * rounding)
    assert (logits.dtype, action.dtype, action.shape) == (np.float32, np.int64, (SAMPLES,))
    one = session.run(["action"], {"observation": observed[:1]})[0]
    assert one.tolist() == [policy(observed[0])]


def test_metadata_of_an_onnx_file_describes_the_policy(tmp_path):
    onnx = pytest.importorskip("onnx")
    export("vertical", "onnx", None, tmp_path / "policy.onnx")
    model = onnx.load(tmp_path / "policy.onnx")
    onnx.checker.check_model(model, full_check=True)
    metadata = {each.key: each.value for each in model.metadata_props}
    described = json.loads((SHIPPED / "vertical" / "policy.json").read_text())
    for name in ("experiment", "task_name", "sha256"):
        assert metadata.pop(name) == described[name]
    assert {name: json.loads(value) for name, value in metadata.items()} == {
        name: described[name] for name in ("seed", "task_version", "observation", "actions")
    }


def test_the_documented_numpy_code_gives_the_same_answers(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    policy = find_policy("lateral-best")
    export("lateral-best", "numpy", None, Path("lateral-best.npz"))
    text = (DOCS / "formats.md").read_text()
    (code,) = re.findall(r"```python\n(import numpy[^`]*lateral-best\.npz[^`]*)```", text)
    for observation in observations(policy)[::1000]:
        found = {"observation": observation}
        exec(code, found)
        np.testing.assert_allclose(found["logits"], policy.logits(observation), rtol=1e-5)
        assert found["action"] == policy(observation)
        assert found["name"] == policy.description.actions[found["action"]]


def test_a_numpy_file_needs_no_pickle_for_tensors_and_names(tmp_path):
    policy = find_policy("avoidance-best")
    export("avoidance-best", "numpy", None, tmp_path / "policy.npz")
    with np.load(tmp_path / "policy.npz", allow_pickle=False) as file:
        found = dict(file)
    for name, tensor in policy.tensors.items():
        np.testing.assert_array_equal(found.pop(name), tensor)
    described = policy.description
    assert tuple(found.pop("observation")) == described.observation
    assert tuple(found.pop("actions")) == described.actions
    assert {name: value.item() for name, value in found.items()} == {
        "experiment": "avoidance-best",
        "seed": described.seed,
        "task_name": described.task_name,
        "task_version": described.task_version,
        "sha256": described.sha256,
    }


def test_rejects_sources_that_do_not_fit_the_format(tmp_path):
    target, head_on = tmp_path / "out", str(EXAMPLES / "head-on.json")
    with pytest.raises(InputError, match=r"scn is for flown .* lateral is a policy .*onnx"):
        export("lateral", "scn", None, target)
    with pytest.raises(InputError, match="is a policy"):
        export(str(SHIPPED / "lateral"), "scn", None, target)
    with pytest.raises(InputError, match=r"numpy is for policies.*head-on\.json holds flown"):
        export(head_on, "numpy", None, target)
    with pytest.raises(InputError, match="did you mean 'lateral'"):
        export("laterla", "numpy", None, target)
    with pytest.raises(InputError, match="only with --format scn"):
        export("lateral", "onnx", 0, target)
    with pytest.raises(InputError, match="does not exist"):
        export("lateral", "numpy", None, tmp_path / "no" / "out.npz")
    assert list(tmp_path.iterdir()) == []


def test_missing_onnx_names_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InputError, match=r"the extra \[onnx\]"):
        onnx_file.export_onnx(find_policy("lateral"), tmp_path / "policy.onnx")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_onnx_example_issues_the_evaluated_clearances(folder):
    pytest.importorskip("onnxruntime")
    command = [sys.executable, "-W", "error", str(EXAMPLES / "onnx_session.py")]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    *printed, last = found.stdout.splitlines()
    issued = pq.read_table(folder / "clearances.parquet", filters=[("scenario", "=", 1)])
    assert issued.num_rows > 1
    assert printed == [
        f"{6 * each['cycle']:4d} s  {each['text']} (from {each['instructions']})"
        for each in issued.to_pylist()
    ]
    assert last == "success: True"
