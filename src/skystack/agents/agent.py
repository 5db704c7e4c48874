"""An agent: a controller that runs outside compiled programs, from any library."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
from jaxtyping import Float

from skystack.errors import InputError
from skystack.io.names import as_name
from skystack.policies.facts import Facts, check_trained_for
from skystack.tasks.contract import Task

AgentFunction = Callable[[Float[np.ndarray, "*scenarios observation"]], Any]
"""A function from observations to actions or scores."""


@dataclass(frozen=True)
class Agent:
    """A controller that is called from Python; it has `act`, `scores` or both. Picklable."""

    name: str
    """Its name in results, and part of the name of the folder with its tables."""
    act: AgentFunction | None = None
    """Maps observations to action numbers."""
    scores: AgentFunction | None = None
    """Maps observations to a score for each action. Without `act`, the highest score is taken."""
    logits: bool = False
    """Whether the scores are logits, from which actions can be sampled."""
    batched: bool = True
    """Whether both take `[scenarios, observation]` rather than a single `[observation]`."""
    observations: int | None = None
    """The number of observed values, if known."""
    actions: int | None = None
    """The number of actions, if known."""
    facts: Facts | None = None
    """The description in an export of one of our own policies."""


@dataclass(frozen=True)
class Batched:
    """Marks a function as a policy that takes many observations at once.

    It maps float32 `[scenarios, observation]` to action numbers `[scenarios]`; the number of
    scenarios differs from call to call.

    Example:

        >>> import numpy as np
        >>> import skystack
        >>> idle = skystack.Batched(lambda observations: np.zeros(len(observations), int))
        >>> two = skystack.Conditions(episodes=2)
        >>> skystack.evaluate(idle, two, experiment="lateral").row["clearances_mean"]
        0.0
    """

    function: AgentFunction


def agent_of(policy: Any, name: str | None = None) -> Agent:
    """Make an agent of a function, a `Batched` function or a model; an agent is returned as it is.

    A model has Stable-Baselines3's `predict(observations, deterministic=True)`, which returns
    actions and a state that must be None. The default name is that of the function or of the
    model's class. Raises InputError for anything else.
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


def check_agent(agent: Agent, task: Task, experiment: str) -> None:
    """Raise InputError if the agent's observation or actions differ from those of the task.

    `experiment` is that of the task, for the message.
    """
    if agent.facts is not None:
        check_trained_for(task, agent.facts, agent.name)
    observations, actions = len(task.observation_names), len(task.action_names)
    if agent.observations not in (None, observations) or agent.actions not in (None, actions):
        sizes = f"{agent.observations or '?'} observed values and {agent.actions or '?'} actions"
        allowed = f"{experiment}: {observations}, {actions}"
        raise InputError(f"{agent.name} has {sizes} (allowed for {allowed})")


def _name(policy: Any) -> str:
    name = getattr(policy, "__name__", type(policy).__name__)
    return name if name.isidentifier() else "policy"


def file_name(path: Path) -> str:
    """The row name for a policy file."""
    return as_name(path.stem)


class _Picklable:
    """A function that can be pickled, even if it is a lambda or is defined in `__main__`."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, *arguments: Any) -> Any:
        return self._function(*arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        return _unpickle, (cloudpickle.dumps(self._function),)


def _unpickle(data: bytes) -> _Picklable:
    return _Picklable(cloudpickle.loads(data))


def _agent_of_model(model: Any, name: str) -> Agent:
    # Only the policy: a model holds its environments, which cannot be sent to other processes.
    policy = getattr(model, "policy", model)
    predict = policy.predict if callable(getattr(policy, "predict", None)) else model.predict
    normalise = _normaliser(model)
    shape = getattr(getattr(model, "observation_space", None), "shape", None)
    actions = getattr(getattr(model, "action_space", None), "n", None)

    def act(observations: np.ndarray) -> Any:
        answer, state = predict(normalise(observations), deterministic=True)
        if state is not None:
            raise InputError(
                "it is recurrent (allowed: policies that depend on the observation only)"
            )
        return answer

    return Agent(
        name,
        act=_Picklable(act),
        observations=shape[0] if shape and len(shape) == 1 else None,
        actions=None if actions is None else int(actions),
    )


def _normaliser(model: Any) -> AgentFunction:
    """The observation normalisation of a model's `VecNormalize`, with its current statistics."""
    get_environment = getattr(model, "get_vec_normalize_env", None)
    environment = get_environment() if callable(get_environment) else None
    if environment is None or not environment.norm_obs:
        return lambda observations: observations
    mean, variance = environment.obs_rms.mean.copy(), environment.obs_rms.var.copy()
    epsilon, clip = environment.epsilon, environment.clip_obs

    def normalise(observations: np.ndarray) -> np.ndarray:
        scaled = (observations - mean) / np.sqrt(variance + epsilon)
        return np.clip(scaled, -clip, clip).astype(np.float32)

    return normalise
