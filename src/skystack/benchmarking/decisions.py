"""How long one stacked decision takes with a policy in numpy: what a live system would wait for."""

import time

import jax
import numpy as np

from skystack.benchmarking.figures import Figure
from skystack.catalogue import find_policy
from skystack.evaluation.judge import task_of
from skystack.learning.inference import forward, normalise
from skystack.learning.policy import Policy
from skystack.seeds import scenario_key
from skystack.stacking import stack
from skystack.tasks.plain import PlainTask

CYCLES = 150


def decision_figures(name: str, scenarios: int) -> list[Figure]:
    """Microseconds of a decision in a cycle without and in one with a clearance."""
    policy = find_policy(name)
    task = task_of(policy)
    environment = PlainTask(task)
    silent: list[float] = []
    spoken: list[float] = []
    for number in range(scenarios + 1):
        state = environment.reset(scenario_key(0, number))
        for _ in range(CYCLES):
            traffic = jax.device_get(state.state)  # as another simulator would report it
            begun = time.perf_counter()
            state = environment.begin(traffic)
            state, issued = stack(environment, lambda seen: act(policy, seen), state)
            np.asarray(state.observation)  # nothing is left under way
            taken = 1e6 * (time.perf_counter() - begun)
            if number:  # the first compiles
                (spoken if issued.instructions else silent).append(taken)
            state, outcome = environment.advance(state)
            if outcome.terminated:
                break
    how = (
        f"policy `{name}` in numpy, two aircraft, {scenarios} scenarios, `skystack.stacking.stack`"
    )
    return [
        Figure("stacked decision, nothing to say", "us", tuple(silent), how),
        Figure("stacked decision, a clearance", "us", tuple(spoken), how),
    ]


def act(policy: Policy, seen: np.ndarray) -> int:
    """The most probable action."""
    return int(np.argmax(forward(policy.actor, normalise(policy.normaliser, seen))))
