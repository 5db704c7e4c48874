"""Query an agent: actions are checked and copied, and errors name the observation and the cycle."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from skystack.agents.agent import Agent, AgentFunction
from skystack.errors import InputError
from skystack.tasks.plain import checked_action


class QueryNames(NamedTuple):
    """Names the observations of a query in messages."""

    numbers: Sequence[int]
    """One number for each observation."""
    cycle: int
    name: Callable[[int], str] = "scenario {}".format
    """Makes a name of a number, such as `scenario 3` or a callsign."""

    @contextmanager
    def errors(self, *numbers: int) -> Iterator[None]:
        """Convert any exception inside to an InputError that names observations and cycle."""
        others = f" and {len(numbers) - 1} more" if len(numbers) > 1 else ""
        where = f"{self.name(numbers[0])}{others}, cycle {self.cycle}"
        try:
            yield
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
        except Exception as error:
            text = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(f"{where}: the policy failed: {text}") from error


def query_actions(
    agent: Agent,
    observations: Float[np.ndarray, "scenarios observation"],
    names: QueryNames,
    actions: int,
) -> Int[np.ndarray, " scenarios"]:
    """The actions that an agent takes: those with the highest score if it has no `act`.

    Raises InputError, which names observation and cycle, for an agent that fails or returns
    anything but one of the actions 0, 1, ...
    """
    if agent.act is None:
        return query_scores(agent, observations, names, actions).argmax(axis=1)
    checked = []
    for number, answer in _answers(agent.act, agent.batched, observations, names):
        with names.errors(number):
            checked.append(checked_action(answer, actions))
    return np.array(checked, dtype=np.int32)


def query_scores(
    agent: Agent,
    observations: Float[np.ndarray, "scenarios observation"],
    names: QueryNames,
    actions: int,
) -> Float[np.ndarray, "scenarios actions"]:
    """An agent's score of each action; raises InputError as `query_actions` does."""
    assert agent.scores is not None, "checked by the caller"
    checked = []
    for number, answer in _answers(agent.scores, agent.batched, observations, names):
        scores = np.array(answer, dtype=np.float32)
        with names.errors(number):
            if scores.shape != (actions,) or not np.all(np.isfinite(scores)):
                raise InputError(
                    f"its scores are {answer} (allowed: {actions} finite numbers, one per action)"
                )
        checked.append(scores)
    return np.stack(checked)


def _answers(
    decide: AgentFunction,
    batched: bool,
    observations: Float[np.ndarray, "scenarios observation"],
    names: QueryNames,
) -> Iterator[tuple[int, Any]]:
    """The number of each scenario and its action or scores, in order."""
    if not batched:
        for number, observation in zip(names.numbers, observations, strict=True):
            with names.errors(number):
                answer = _plain(decide(observation))
            yield number, answer
        return
    with names.errors(*names.numbers):
        answers = _plain(decide(observations))
        if not isinstance(answers, list | tuple):
            raise InputError(f"it returned {answers!r} (allowed: a list, one item per observation)")
        if len(answers) != len(names.numbers):
            raise InputError(
                f"it returned a list of {len(answers)} for {len(names.numbers)} observations "
                "(allowed: one item per observation)"
            )
    yield from zip(names.numbers, answers, strict=True)


def _plain(answer: Any) -> Any:
    """An array of any library as plain numbers, which later changes to the array cannot affect."""
    return answer.tolist() if hasattr(answer, "tolist") else answer
