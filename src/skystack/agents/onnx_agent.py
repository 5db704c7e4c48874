"""Policies in ONNX files from any library (extra `[onnx]`). The files are untrusted.

A graph contains no code, but it can use every operator of onnxruntime.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from skystack.agents.agent import Agent, file_name
from skystack.errors import InputError, error_context, missing_extra
from skystack.io.files import read_whole
from skystack.policies.facts import facts_from_texts

MAX_VALUES = 100_000
"""The maximum number of values in an observation."""
ALLOWED = (
    "allowed: one float32 input [batch, observation], and an int64 output [batch] of actions or a "
    "float32 output [batch, actions] of logits, named action and logits if there are several"
)
FATAL_ONLY = 4
"""onnxruntime's log severity: relevant problems are raised as exceptions."""


def read_onnx(path: Path) -> Agent:
    """The policy in an ONNX file.

    Its input is float32 `[batch, observation]`; its output is `action`, int64 `[batch]`, or
    `logits`, float32 `[batch, actions]`; `batch` is free or 1. Raises InputError for a file that is
    missing, damaged, of another form or with data in other files, and if the extra is missing.
    """
    with error_context(str(path)):
        data = read_whole(path)
    _packages(str(path))
    with error_context(str(path)):
        return replace(_agent(data), name=file_name(path))


def _packages(path: str) -> tuple[Any, Any]:
    try:
        import onnx  # noqa: PLC0415
        import onnxruntime  # noqa: PLC0415
    except ImportError:
        raise missing_extra(path, "onnx and onnxruntime", "onnx") from None
    return onnx, onnxruntime


class _Form(NamedTuple):
    """The inputs and outputs of a session; `action` and `logits` are names of outputs."""

    batched: bool
    observations: int
    action: str | None
    logits: str | None
    actions: int | None


class _Output:
    """A function from observations to one output of a session. Picklable, unlike a session."""

    def __init__(self, data: bytes, session: Any, name: str, batched: bool) -> None:
        self._data, self._session, self._name, self._batched = data, session, name, batched
        self._input = session.get_inputs()[0].name

    def __call__(self, observations: Float[np.ndarray, "*scenarios observation"]) -> Any:
        rows = observations if self._batched else observations[None]
        (answer,) = self._session.run([self._name], {self._input: rows})
        return answer if self._batched else answer[0]

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickle, (self._data, self._name, self._batched)


def _unpickle(data: bytes, name: str, batched: bool) -> _Output:
    return _Output(data, _session(data), name, batched)


def _agent(data: bytes) -> Agent:
    _refuse_other_files(data)
    session = _session(data)
    try:
        form = _form(session)
        texts = session.get_modelmeta().custom_metadata_map
    except UnicodeDecodeError as error:
        raise InputError(f"holds a text that is not UTF-8: {error}") from None
    outputs = {
        kind: _Output(data, session, name, form.batched) if name else None
        for kind, name in (("act", form.action), ("scores", form.logits))
    }
    facts = facts_from_texts(texts)
    actions = form.actions or (len(facts.actions) if facts else None)
    return Agent(
        "",
        **outputs,
        logits=form.logits is not None,
        batched=form.batched,
        observations=form.observations,
        actions=actions,
        facts=facts,
    )


def _refuse_other_files(data: bytes) -> None:
    """Refuse weights in other files: a model could name any file that the user can read."""
    onnx, _ = _packages("ONNX")
    try:
        model = onnx.load_model_from_string(data)
    except Exception as error:  # protobuf has its own exceptions
        raise InputError(f"is not ONNX: {error}") from None
    for tensor in _tensors(onnx, model):
        if tensor.external_data or tensor.data_location == onnx.TensorProto.EXTERNAL:
            raise InputError(
                "keeps its weights in another file (allowed: one file, as written by "
                "onnx.save_model(..., save_as_external_data=False))"
            )


def _tensors(onnx: Any, message: Any) -> Iterator[Any]:
    """All tensors of a message: in initialisers, attributes, functions and inner graphs."""
    if isinstance(message, onnx.TensorProto):
        yield message
        return
    for field, value in message.ListFields():
        if field.message_type is not None:
            for inner in [value] if hasattr(value, "ListFields") else value:
                yield from _tensors(onnx, inner)


def _session(data: bytes) -> Any:
    _, onnxruntime = _packages("ONNX")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = FATAL_ONLY
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has many exceptions for damaged files
        raise InputError(f"onnxruntime cannot run it: {error}") from None


def _form(session: Any) -> _Form:
    """Determine the input from its declaration, and the outputs from a run on zeros."""
    inputs = session.get_inputs()
    if len(inputs) != 1 or inputs[0].type != "tensor(float)" or len(inputs[0].shape) != 2:
        listed = ", ".join(f"{each.name} {each.type} {each.shape}" for each in inputs)
        raise InputError(f"its inputs are {listed or 'none'} ({ALLOWED})")
    batch, observations = inputs[0].shape
    batched = not isinstance(batch, int)  # the name of a free dimension, or None
    if not (batched or batch == 1) or not isinstance(observations, int):
        raise InputError(f"its input is {inputs[0].shape} ({ALLOWED})")
    if not 1 <= observations <= MAX_VALUES:
        raise InputError(f"it observes {observations} values (allowed: 1 to {MAX_VALUES})")
    rows = 2 if batched else 1
    outputs = _run(session, np.zeros((rows, observations), np.float32))
    of_rows = {name: each for name, each in outputs.items() if each.shape[:1] == (rows,)}
    vectors = [n for n, a in of_rows.items() if a.dtype == np.int64 and a.ndim == 1]
    matrices = [n for n, a in of_rows.items() if a.dtype == np.float32 and a.ndim == 2]
    action = _choose("action", vectors)
    logits = _choose("logits", [name for name in matrices if outputs[name].shape[1] > 1])
    if action is None and logits is None:
        listed = ", ".join(f"{name} {a.dtype} {list(a.shape)}" for name, a in outputs.items())
        raise InputError(f"its outputs are {listed} ({ALLOWED})")
    actions = outputs[logits].shape[1] if logits else None
    return _Form(batched, observations, action, logits, actions)


def _run(session: Any, zeros: Float[np.ndarray, "rows observation"]) -> dict[str, np.ndarray]:
    names = [each.name for each in session.get_outputs()]
    try:
        outputs = session.run(names, {session.get_inputs()[0].name: zeros})
    except Exception as error:
        raise InputError(f"onnxruntime cannot run it on zeros: {error}") from None
    return {n: a for n, a in zip(names, outputs, strict=True) if isinstance(a, np.ndarray)}


def _choose(name: str, fitting: Sequence[str]) -> str | None:
    """The output called `name`, or else the only one that fits."""
    if name in fitting:
        return name
    return fitting[0] if len(fitting) == 1 else None
