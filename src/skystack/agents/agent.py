"""An agent: what decides outside compiled programs, whatever library it comes from."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
from jaxtyping import Float

from skystack.errors import InputError
from skystack.io.names import as_name
from skystack.policies.facts import Facts

AnswerFunction = Callable[[Float[np.ndarray, "*scenarios observation"]], Any]


@dataclass(frozen=True)
class Agent:
    """A controller that is asked from Python; it has `act`, `scores` or both. Picklable."""

    name: str
    """Of its row; also part of the name of the folder with its tables."""
    act: AnswerFunction | None = None
    """From observations to action numbers."""
    scores: AnswerFunction | None = None
    """From observations to a number for each action; without `act` the greatest is taken."""
    logits: bool = False
    """Whether scores are unnormalised log probabilities, which can be sampled from."""
    batched: bool = True
    """Whether both map `[scenarios, observation]`, or a single `[observation]`."""
    observations: int | None = None
    """How many values it observes, where that is known."""
    actions: int | None = None
    """How many actions it has, where that is known."""
    facts: Facts | None = None
    """What an export of our own policies says of itself."""


@dataclass(frozen=True)
class Batched:
    """Marks a function as one of many observations at once.

    It maps float32 `[scenarios, observation]` to action numbers `[scenarios]`; the number of
    scenarios differs from call to call.
    """

    function: AnswerFunction


def agent_of(policy: Any, name: str | None = None) -> Agent:
    """The agent of a function, a `Batched` function or a model with `predict`; or it itself.

    Without a name it has that of the function or of the model's class.

    `predict(observations, deterministic=True)` is that of Stable-Baselines3: it returns actions
    and a state, which must be None. Raises InputError for anything else.
    """
    if isinstance(policy, Agent):
        return policy
    if isinstance(policy, Batched):
        return Agent(name or _name(policy.function), act=_Picklable(policy.function))
    if callable(getattr(policy, "predict", None)):
        return _agent_of_model(policy, name or _name(policy))
    if callable(policy):
        return Agent(name or _name(policy), act=_Picklable(policy), batched=False)
    raise InputError(
        f"policy is {policy!r} (allowed: a policy of find_policy or find_agent, a function from "
        "an observation to an action, or a model with predict)"
    )


def _name(policy: Any) -> str:
    name = getattr(policy, "__name__", type(policy).__name__)
    return name if name.isidentifier() else "policy"


def file_name(path: Path) -> str:
    """The name of the row of a policy file."""
    return as_name(path.stem)


class _Picklable:
    """A function that reaches other processes: those of `__main__` and lambdas too."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, *arguments: Any) -> Any:
        return self._function(*arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        return _received, (cloudpickle.dumps(self._function),)


def _received(data: bytes) -> _Picklable:
    return _Picklable(cloudpickle.loads(data))


def _agent_of_model(model: Any, name: str) -> Agent:
    # The policy alone: a model holds its environments, which cannot be sent to other processes.
    policy = getattr(model, "policy", model)
    predict = policy.predict if callable(getattr(policy, "predict", None)) else model.predict
    normalise = _normaliser(model)
    shape = getattr(getattr(model, "observation_space", None), "shape", None)
    actions = getattr(getattr(model, "action_space", None), "n", None)

    def act(observations: np.ndarray) -> Any:
        answer, state = predict(normalise(observations), deterministic=True)
        if state is not None:
            raise InputError("it remembers (allowed: policies that decide by the observation)")
        return answer

    return Agent(
        name,
        act=_Picklable(act),
        observations=shape[0] if shape and len(shape) == 1 else None,
        actions=None if actions is None else int(actions),
    )


def _normaliser(model: Any) -> AnswerFunction:
    """What a model's `VecNormalize` does to observations, as it is now."""
    find = getattr(model, "get_vec_normalize_env", None)
    environment = find() if callable(find) else None
    if environment is None or not environment.norm_obs:
        return lambda observations: observations
    mean, variance = environment.obs_rms.mean.copy(), environment.obs_rms.var.copy()
    smallest, clip = environment.epsilon, environment.clip_obs

    def normalise(observations: np.ndarray) -> np.ndarray:
        scaled = (observations - mean) / np.sqrt(variance + smallest)
        return np.clip(scaled, -clip, clip).astype(np.float32)

    return normalise
