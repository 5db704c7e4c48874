"""How long one stacked decision takes with a policy in numpy: what a live system would wait for."""

import time

import jax

from skystack.benchmarking.figures import Figure
from skystack.evaluation.evaluate import policy_task
from skystack.learning.seeds import scenario_key
from skystack.policies.shipped import find_policy
from skystack.stacking import stack
from skystack.tasks.plain import PlainTask

CYCLES = 150


def decision_figures(name: str, scenarios: int) -> list[Figure]:
    """Microseconds from traffic to observation, and of a decision with and without a clearance."""
    policy = find_policy(name)
    task = policy_task(policy)
    environment = PlainTask(task)
    look: list[float] = []
    silent: list[float] = []
    spoken: list[float] = []
    for number in range(scenarios + 1):
        seen = environment.reset(scenario_key(0, number))
        for _ in range(CYCLES):
            # As another simulator would report it: many small arrays.
            reported = jax.device_get(environment.state_of(seen))
            begun = time.perf_counter()
            seen = environment.begin(reported)
            environment.observe(seen)
            looked = time.perf_counter()
            seen, issued = stack(environment, policy, seen)
            environment.observe(seen)  # nothing is left under way
            done = time.perf_counter()
            if number:  # the first compiles
                look.append(1e6 * (looked - begun))
                (spoken if issued.instructions else silent).append(1e6 * (done - looked))
            seen, outcome = environment.advance(seen)
            if outcome.terminated:
                break
    how = f"policy `{name}` in numpy, two aircraft, {scenarios} scenarios; "
    deciding = how + "`skystack.stacking.stack`, all queries of a cycle"
    return [
        Figure("traffic to observation", "us", tuple(look), how + "`PlainTask.begin`"),
        Figure("stacked decision, nothing to say", "us", tuple(silent), deciding),
        Figure("stacked decision, a clearance", "us", tuple(spoken), deciding),
    ]
