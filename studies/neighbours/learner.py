"""Train with PPO until a budget of simulated cycles is used up."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from skystack.evaluation.rollout import TracedPolicy
from skystack.learning import ppo
from skystack.learning.collection import TrainState
from skystack.learning.experiment import Experiment
from skystack.learning.inference import forward, normalise
from skystack.learning.seeds import training_key
from skystack.tasks.observations import flatten_observation
from skystack.tasks.stacked_steps import StackedSteps
from studies.neighbours.methods import Build, Method, build

State = TypeVar("State")
GOOD = 0.8
"""A policy has learned if all aircraft make a correct exit in this share of scenarios."""
WINDOW = 100
"""The success rate in training is averaged over at least this many scenarios."""


class Trained(NamedTuple):
    """A trained policy and the cost of its training."""

    decide: TracedPolicy
    """The greedy policy."""
    sample: TracedPolicy
    weights: Any
    cycles_to_good: int | None
    """The number of cycles until the share of correct exits reached `GOOD`; None if never."""
    train_s: float
    """Time for training, without compilation."""


class Budget:
    """Counts the simulated cycles of a training run, and records when it first reaches `GOOD`.

    Measured on the training scenarios, with sampled actions. Unfinished scenarios are not counted.
    In frozen time, every step counts as one cycle, because a policy may issue many instructions in
    one cycle.
    """

    def __init__(self, steps: int | None = None) -> None:
        """`steps` is the number of steps of an update in frozen time."""
        self.steps = steps
        self.cycles = 0.0
        self.train_s = 0.0
        """Time spent, without compilation."""
        self.good_after: int | None = None
        self._scenarios = self._good = 0.0

    def add(self, measured: dict[str, Any]) -> None:
        """Add an update with its measured values: means over the scenarios that ended."""
        episodes = float(measured["episodes"])
        self.cycles += self.steps or 0.0
        if not episodes:
            return
        if self.steps is None:
            self.cycles += episodes * float(measured["cycles"])
        self._scenarios += episodes
        self._good += episodes * float(measured["correct_exit"])
        if self._scenarios < WINDOW:
            return
        if self.good_after is None and self._good >= GOOD * self._scenarios:
            self.good_after = round(self.cycles)
        self._scenarios = self._good = 0.0

    def spend(
        self, until: float, update: Callable[[State], tuple[State, Any]], state: State
    ) -> State:
        """The train state after updates until so many cycles have been simulated."""
        started = time.perf_counter()
        while self.cycles < until:
            state, measured = update(state)
            self.add(jax.device_get(measured))
        self.train_s += time.perf_counter() - started
        return state


def train(method: Method, experiment: Experiment, cycles: int, seed: int) -> Trained:
    """Train a method, first with the rewards of pre-training if the experiment has any."""
    settings, target = experiment.ppo, build(method, experiment)
    budget = Budget(settings.samples if isinstance(target.trained, StackedSteps) else None)
    head = target.head
    phases = [(cycles, target)]
    if experiment.pretraining is not None:
        share = experiment.pretraining.steps / settings.total_steps
        phases.insert(0, (round(share * cycles), build(method, experiment, pretraining=True)))
    state = jax.jit(partial(ppo.init, target.trained, settings, head=head))(training_key(seed))
    for until, phase in phases:
        state = budget.spend(until, compiled_update(phase, experiment, state), state)
    weights = state.parameters.actor, state.normaliser
    greedy, sampled = (network_policy(target, greedy) for greedy in (True, False))
    return Trained(greedy, sampled, weights, budget.good_after, budget.train_s)


def compiled_update(phase: Build, experiment: Experiment, state: TrainState) -> Callable[..., Any]:
    """The compiled `ppo.update` of a phase."""
    update = partial(ppo.update, phase.trained, experiment.ppo, head=phase.head)
    compiled: Callable[..., Any] = jax.jit(update).lower(state).compile()
    return compiled


def network_policy(tasks: Build, greedy: bool) -> TracedPolicy:
    """A policy with weights (actor, normaliser) that takes the best decision or samples one."""

    def decide(
        weights: Any, observation: Float[Array, " observation"], key: PRNGKeyArray
    ) -> Int[Array, ""]:
        actor, normaliser = weights
        logits = forward(actor, normalise(normaliser, flatten_observation(observation)))
        if tasks.head is not None:
            logits = tasks.head.logits(logits[:, None])[:, 0]
        if not greedy:
            decision = jax.random.categorical(key, logits)
        elif tasks.lengths is None:
            decision = jnp.argmax(logits)
        else:
            decision = best_action_and_length(logits, tasks.lengths)
        return decision.astype(jnp.int32)

    return decide


def best_action_and_length(logits: Float[Array, " decisions"], lengths: int) -> Int[Array, ""]:
    """The action with the highest probability summed over its lengths, and that action's most
    probable length."""
    by_action = logits.reshape(-1, lengths)
    action = jnp.argmax(jax.nn.logsumexp(by_action, axis=1))
    return action * lengths + jnp.argmax(by_action[action])
