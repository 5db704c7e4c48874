"""Policies in ONNX files, of any library (extra `[onnx]`): run, never trusted.

A graph has no code of its own, but whatever operators of onnxruntime it names.
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

MOST_VALUES = 100_000
"""Of one observation."""
ALLOWED = (
    "allowed: one float32 input [batch, observation], and an int64 output [batch] of actions or a "
    "float32 output [batch, actions] of logits, named so where there are several"
)
FATAL_ONLY = 4
"""Severity of what onnxruntime logs: what matters comes as an error."""


def read_onnx(path: Path) -> Agent:
    """The policy in an ONNX file.

    It observes float32 `[batch, observation]` and answers with `action`, int64 `[batch]`, or
    `logits`, float32 `[batch, actions]`; `batch` is free or 1. Raises InputError for a file that is
    missing, damaged, of another form or with data in other files, and where the extra is missing.
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
    """What goes into a session and comes out."""

    batched: bool
    observations: int
    action: str | None
    logits: str | None
    actions: int | None


class _Asked:
    """One output of a session, by observations; picklable, as the session itself is not."""

    def __init__(self, data: bytes, session: Any, name: str, batched: bool) -> None:
        self._data, self._session, self._name, self._batched = data, session, name, batched
        self._input = session.get_inputs()[0].name

    def __call__(self, observations: Float[np.ndarray, "*scenarios observation"]) -> Any:
        rows = observations if self._batched else observations[None]
        (answer,) = self._session.run([self._name], {self._input: rows})
        return answer if self._batched else answer[0]

    def __reduce__(self) -> tuple[Any, ...]:
        return _asked, (self._data, self._name, self._batched)


def _asked(data: bytes, name: str, batched: bool) -> _Asked:
    return _Asked(data, _session(data), name, batched)


def _agent(data: bytes) -> Agent:
    _refuse_other_files(data)
    session = _session(data)
    try:
        form = _form(session)
        texts = session.get_modelmeta().custom_metadata_map
    except UnicodeDecodeError as error:
        raise InputError(f"holds a text that is not UTF-8: {error}") from None
    outputs = {
        kind: _Asked(data, session, name, form.batched) if name else None
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
    """Weights may lie in files that a model names: any that the user may read."""
    onnx, _ = _packages("ONNX")
    try:
        model = onnx.load_model_from_string(data)
    except Exception as error:  # protobuf's own kinds
        raise InputError(f"is not ONNX: {error}") from None
    for tensor in _tensors(onnx, model):
        if tensor.external_data or tensor.data_location == onnx.TensorProto.EXTERNAL:
            raise InputError(
                "keeps its weights in another file (allowed: all in one file, as "
                "onnx.save_model(..., save_as_external_data=False) writes it)"
            )


def _tensors(onnx: Any, message: Any) -> Iterator[Any]:
    """All tensors, wherever they are: initialisers, attributes, functions, inner graphs."""
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
    except Exception as error:  # onnxruntime has a kind for each kind of damage
        raise InputError(f"onnxruntime cannot run it: {error}") from None


def _form(session: Any) -> _Form:
    """Its input from what it declares, its outputs from what it answers to zeros."""
    inputs = session.get_inputs()
    if len(inputs) != 1 or inputs[0].type != "tensor(float)" or len(inputs[0].shape) != 2:
        shown = ", ".join(f"{each.name} {each.type} {each.shape}" for each in inputs)
        raise InputError(f"its inputs are {shown or 'none'} ({ALLOWED})")
    batch, observations = inputs[0].shape
    batched = not isinstance(batch, int)  # a name, or none at all
    if not (batched or batch == 1) or not isinstance(observations, int):
        raise InputError(f"its input is {inputs[0].shape} ({ALLOWED})")
    if not 1 <= observations <= MOST_VALUES:
        raise InputError(f"it observes {observations} values (allowed: 1 to {MOST_VALUES})")
    rows = 2 if batched else 1
    answers = _answers(session, np.zeros((rows, observations), np.float32))
    of_rows = {name: each for name, each in answers.items() if each.shape[:1] == (rows,)}
    whole = [n for n, a in of_rows.items() if a.dtype == np.int64 and a.ndim == 1]
    tables = [n for n, a in of_rows.items() if a.dtype == np.float32 and a.ndim == 2]
    action = _one("action", whole)
    logits = _one("logits", [name for name in tables if answers[name].shape[1] > 1])
    if action is None and logits is None:
        shown = ", ".join(f"{name} {a.dtype} {list(a.shape)}" for name, a in answers.items())
        raise InputError(f"its outputs are {shown} ({ALLOWED})")
    actions = answers[logits].shape[1] if logits else None
    return _Form(batched, observations, action, logits, actions)


def _answers(session: Any, zeros: Float[np.ndarray, "rows observation"]) -> dict[str, np.ndarray]:
    names = [each.name for each in session.get_outputs()]
    try:
        answers = session.run(names, {session.get_inputs()[0].name: zeros})
    except Exception as error:
        raise InputError(f"onnxruntime cannot run it on zeros: {error}") from None
    return {n: a for n, a in zip(names, answers, strict=True) if isinstance(a, np.ndarray)}


def _one(name: str, fitting: Sequence[str]) -> str | None:
    """The output of a name, or else the only one that fits."""
    if name in fitting:
        return name
    return fitting[0] if len(fitting) == 1 else None
