"""A policy as an ONNX graph, for any ONNX runtime (extra `[onnx]`).

The input is the task's observation: the normaliser is part of the graph.
"""

from pathlib import Path
from typing import Any

import numpy as np

import skystack
from skystack.errors import missing_extra
from skystack.io.files import atomic_write
from skystack.learning.inference import CLIP, SMALLEST_VARIANCE
from skystack.learning.policy import Policy
from skystack.policies.facts import facts, facts_as_texts

OPSET, IR_VERSION = 17, 8
"""Versions of 2022, so that older runtimes can read the file."""


def export_onnx(policy: Policy, output: Path) -> None:
    """Write the policy as ONNX, from observations to logits and actions; see docs/formats.md.

    Raises InputError if the extra is missing or the file cannot be written.
    """
    onnx = _onnx()
    model = _model(onnx, policy)
    onnx.checker.check_model(model, full_check=True)
    atomic_write(output, model.SerializeToString())


def _onnx() -> Any:
    try:
        import onnx  # noqa: PLC0415
    except ImportError:
        raise missing_extra("--format onnx", "onnx", "onnx") from None
    return onnx


def _model(onnx: Any, policy: Policy) -> Any:
    helper, kinds = onnx.helper, onnx.TensorProto
    described = facts(policy)
    observations, actions = len(described["observation"]), len(described["actions"])
    graph = helper.make_graph(
        _nodes(helper, len(policy.actor)),
        described["experiment"],
        [helper.make_tensor_value_info("observation", kinds.FLOAT, ["batch", observations])],
        [
            helper.make_tensor_value_info("logits", kinds.FLOAT, ["batch", actions]),
            helper.make_tensor_value_info("action", kinds.INT64, ["batch"]),
        ],
        [onnx.numpy_helper.from_array(value, name) for name, value in _constants(policy).items()],
    )
    model = helper.make_model(
        graph,
        ir_version=IR_VERSION,
        opset_imports=[helper.make_opsetid("", OPSET)],
        producer_name="skystack",
        producer_version=skystack.__version__,
    )
    helper.set_model_props(model, facts_as_texts(policy))
    return model


def _nodes(helper: Any, layers: int) -> list[Any]:
    """Normalise and clip; dense layers with ReLU between them; the first of the largest logits."""
    nodes = [
        helper.make_node("Sub", ["observation", "normaliser.mean"], ["centred"]),
        helper.make_node("Div", ["centred", "normaliser.deviation"], ["scaled"]),
        helper.make_node("Clip", ["scaled", "least", "greatest"], ["value.0"]),
    ]
    for layer in range(layers):
        inputs = [f"value.{layer}", f"actor.{layer}.weights", f"actor.{layer}.biases"]
        last = layer == layers - 1
        summed = "logits" if last else f"sum.{layer}"
        nodes.append(helper.make_node("Gemm", inputs, [summed]))
        if not last:
            nodes.append(helper.make_node("Relu", [summed], [f"value.{layer + 1}"]))
    return [*nodes, helper.make_node("ArgMax", ["logits"], ["action"], axis=1, keepdims=0)]


def _constants(policy: Policy) -> dict[str, np.ndarray]:
    tensors = policy.tensors
    variance = tensors.pop("normaliser.variance")
    tensors["normaliser.deviation"] = np.sqrt(variance + np.float32(SMALLEST_VARIANCE))
    return tensors | {"least": np.array(-CLIP, np.float32), "greatest": np.array(CLIP, np.float32)}
