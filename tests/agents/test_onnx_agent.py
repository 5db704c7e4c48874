"""ONNX files of any library as policies: what is accepted, and what is refused."""

import os
import pickle
import sys

import numpy as np
import pytest

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

import onnx
from onnx import TensorProto, helper, numpy_helper

import skystack
from skystack.agents.find import find_agent
from skystack.agents.onnx_agent import read_onnx
from skystack.errors import InputError
from skystack.evaluation.evaluate import Conditions, agent_task
from skystack.export.onnx_file import export_onnx
from skystack.policies.shipped import find_policy

FLOAT, INT64 = TensorProto.FLOAT, TensorProto.INT64
OBSERVATIONS, ACTIONS = 14, 5
WEIGHTS = np.random.default_rng(0).normal(size=(OBSERVATIONS, ACTIONS)).astype(np.float32)
ROWS = np.random.default_rng(1).uniform(size=(50, OBSERVATIONS)).astype(np.float32)


def write(path, outputs=("logits", "action"), batch="batch", extra_nodes=(), **metadata):
    """A linear policy: logits, and the action with the greatest."""
    known = {
        "logits": helper.make_tensor_value_info("logits", FLOAT, [batch, ACTIONS]),
        "action": helper.make_tensor_value_info("action", INT64, [batch]),
        "value": helper.make_tensor_value_info("value", FLOAT, [batch, 1]),
        "second": helper.make_tensor_value_info("second", FLOAT, [batch, ACTIONS]),
    }
    nodes = [
        helper.make_node("MatMul", ["seen", "weights"], ["logits"]),
        helper.make_node("ArgMax", ["logits"], ["action"], axis=1, keepdims=0),
        helper.make_node("ReduceMax", ["logits"], ["value"], axes=[1]),
        helper.make_node("Neg", ["logits"], ["second"]),
    ]
    graph = helper.make_graph(
        nodes,
        "linear",
        [helper.make_tensor_value_info("seen", FLOAT, [batch, OBSERVATIONS])],
        [known[name] for name in outputs],
        [numpy_helper.from_array(WEIGHTS, "weights")],
    )
    return save(path, graph, metadata)


def save(path, graph, metadata=None):
    opset = [helper.make_opsetid("", 17)]
    model = helper.make_model(graph, ir_version=8, opset_imports=opset)
    helper.set_model_props(model, metadata or {})
    path.write_bytes(model.SerializeToString())
    return path


def answers(agent):
    rows = ROWS if agent.batched else None
    if agent.act is not None:
        return agent.act(rows) if agent.batched else np.array([agent.act(row) for row in ROWS])
    scores = agent.scores(rows) if agent.batched else [agent.scores(row) for row in ROWS]
    return np.argmax(scores, axis=1)


@pytest.mark.parametrize("batch", ["batch", 1])
@pytest.mark.parametrize(
    "outputs", [("action",), ("logits",), ("logits", "action"), ("action", "value", "second")]
)
def test_gives_the_answers_of_the_matrix(outputs, batch, tmp_path):
    agent = read_onnx(write(tmp_path / "a b.onnx", outputs, batch))
    expected = (ROWS @ WEIGHTS).argmax(axis=1)
    np.testing.assert_array_equal(answers(agent), expected)
    assert (agent.name, agent.observations, agent.facts) == ("a-b", OBSERVATIONS, None)
    assert agent.logits == (agent.scores is not None)
    if "logits" in outputs:
        assert agent.actions == ACTIONS
    np.testing.assert_array_equal(answers(pickle.loads(pickle.dumps(agent))), expected)


@pytest.mark.slow
def test_our_own_export_names_its_experiment(tmp_path):
    policy = find_policy("lateral-best")
    export_onnx(policy, tmp_path / "mine.onnx")
    agent = find_agent(str(tmp_path / "mine.onnx"))
    assert agent.facts.experiment == "lateral-best"
    assert agent.facts.sha256 == policy.description.sha256
    assert agent_task(agent, None).observation_names == policy.description.observation
    with pytest.raises(InputError, match="mine: its observation or actions differ from those"):
        agent_task(agent, "lateral-large")
    conditions = Conditions(episodes=3)
    theirs, ours = (skystack.evaluate(each, conditions) for each in (agent, policy))
    assert theirs.clearances.equals(ours.clearances)
    assert (theirs.row["experiment"], theirs.row["seed"]) == ("mine", ours.row["seed"])


def facts(**changes):
    described = {
        "experiment": "lateral",
        "seed": "0",
        "task_name": "lateral",
        "task_version": "1",
        "observation": "[]",
        "actions": "[]",
        "sha256": "",
    }
    return described | changes


def test_rejects_invalid_metadata_and_ignores_foreign(tmp_path):
    path = tmp_path / "policy.onnx"
    with pytest.raises(InputError, match=r"policy.onnx: seed in its metadata is damaged"):
        read_onnx(write(path, **facts(seed="none")))
    with pytest.raises(InputError, match="observation in its metadata is damaged"):
        read_onnx(write(path, **facts(observation="[" * 100_000)))
    # Other programs may use some of the same keys.
    assert read_onnx(write(path, experiment="mlflow", seed="x")).facts is None
    for name in (str(tmp_path / "secret.toml"), "../secret", ""):
        with pytest.raises(InputError, match=r"metadata is damaged: experiment is .*: 1 to 80 of"):
            read_onnx(write(path, **facts(experiment=name)))
    elsewhere = read_onnx(write(path, **facts(experiment="secret.toml")))
    with pytest.raises(InputError, match=r"is not shipped.*--experiment NAME"):
        agent_task(elsewhere, None)


def test_rejects_weights_in_other_files(tmp_path, monkeypatch):
    """In an initializer, in an attribute and in a nested graph."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "passwd").write_bytes(WEIGHTS.tobytes())
    outside = numpy_helper.from_array(WEIGHTS, "weights")
    outside.ClearField("raw_data")
    outside.data_location = TensorProto.EXTERNAL
    for key, value in (("location", "passwd"), ("offset", "0")):
        outside.external_data.add(key=key, value=value)
    seen = helper.make_tensor_value_info("seen", FLOAT, ["batch", OBSERVATIONS])
    logits = helper.make_tensor_value_info("logits", FLOAT, ["batch", ACTIONS])
    multiply = helper.make_node("MatMul", ["seen", "weights"], ["logits"])
    constant = helper.make_node("Constant", [], ["weights"], value=outside)
    inner = helper.make_graph([constant, multiply], "inner", [], [logits])
    nested = [
        helper.make_node("Constant", [], ["yes"], value=numpy_helper.from_array(np.array(True))),
        helper.make_node("If", ["yes"], ["logits"], then_branch=inner, else_branch=inner),
    ]
    graphs = [
        helper.make_graph([multiply], "plain", [seen], [logits], [outside]),
        helper.make_graph([constant, multiply], "attribute", [seen], [logits]),
        helper.make_graph(nested, "nested", [seen], [logits]),
    ]
    for graph in graphs:
        with pytest.raises(InputError, match="weights in another file"):
            read_onnx(save(tmp_path / "policy.onnx", graph))


@pytest.mark.parametrize(
    ("inputs", "outputs", "message"),
    [
        ([("seen", TensorProto.DOUBLE, ["b", 3])], [3], r"its inputs are seen tensor\(double\)"),
        (
            [("seen", FLOAT, ["b", 3]), ("mask", FLOAT, ["b", 3])],
            [3],
            r"its inputs are seen .*mask",
        ),
        ([("seen", FLOAT, ["b", 2, 3])], [2, 3], "its inputs are seen"),
        ([("seen", FLOAT, [8, 3])], [3], r"its input is \[8, 3\]"),
        ([("seen", FLOAT, ["b", "n"])], ["n"], r"its input is \['b', 'n'\]"),
        ([("seen", FLOAT, ["b", 1])], [1], r"its outputs are out float32 \[2, 1\]"),
        ([("seen", FLOAT, ["b", 10**6])], [10**6], "it observes 1000000 values"),
    ],
)
def test_rejects_other_inputs_and_outputs(inputs, outputs, message, tmp_path):
    kind, shape = inputs[0][1], [inputs[0][2][0], *outputs]
    graph = helper.make_graph(
        [helper.make_node("Identity", ["seen"], ["out"])],
        "other",
        [helper.make_tensor_value_info(*each) for each in inputs],
        [helper.make_tensor_value_info("out", kind, shape)],
    )
    with pytest.raises(InputError, match=rf"^.*policy.onnx: {message}"):
        read_onnx(save(tmp_path / "policy.onnx", graph))


def test_of_several_possible_outputs_takes_the_one_named_logits(tmp_path):
    agent = read_onnx(write(tmp_path / "policy.onnx", ("second", "logits")))
    np.testing.assert_allclose(agent.scores(ROWS), ROWS @ WEIGHTS, rtol=1e-4, atol=1e-5)
    path = write(tmp_path / "policy.onnx", ("second", "logits"))
    model = onnx.load(path)
    for node in model.graph.node:
        for names in (node.input, node.output):
            names[:] = ["first" if name == "logits" else name for name in names]
    model.graph.output[1].name = "first"
    onnx.save(model, path)
    with pytest.raises(InputError, match=r"its outputs are second float32 \[2, 5\], first"):
        read_onnx(path)


def test_rejects_damaged_files_in_one_line(tmp_path, capfd):
    path = tmp_path / "policy.onnx"
    whole = write(path).read_bytes()
    with pytest.raises(InputError, match="cannot be read"):
        find_agent(str(tmp_path / "none.onnx"))
    for data in (b"", b"PK\x03\x04 no", whole[: len(whole) // 2], os.urandom(100)):
        path.write_bytes(data)
        with pytest.raises(InputError) as caught:
            read_onnx(path)
        assert str(caught.value).isprintable()
    unknown = helper.make_graph(
        [helper.make_node("Conjure", ["seen"], ["out"])],
        "unknown",
        [helper.make_tensor_value_info("seen", FLOAT, ["b", 3])],
        [helper.make_tensor_value_info("out", FLOAT, ["b", 3])],
    )
    with pytest.raises(InputError, match="onnxruntime cannot run it"):
        read_onnx(save(path, unknown))
    assert capfd.readouterr() == ("", "")


def test_rejects_a_file_that_is_too_large(tmp_path):
    path = tmp_path / "policy.onnx"
    with path.open("wb") as file:
        file.truncate(65_000_000)
    with pytest.raises(InputError, match=r"policy.onnx: is too large"):
        read_onnx(path)


def test_missing_onnxruntime_names_its_extra(tmp_path, monkeypatch):
    path = write(tmp_path / "policy.onnx")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(InputError, match=r"policy.onnx needs onnx and onnxruntime.*\[onnx\]"):
        read_onnx(path)
