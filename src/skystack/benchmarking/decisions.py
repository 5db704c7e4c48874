"""The time of one stacked decision with a policy in numpy, as in a live system."""

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
    """Microseconds from traffic to observation, and per decision with and without a clearance."""
    policy = find_policy(name)
    task = policy_task(policy)
    environment = PlainTask(task)
    observing: list[float] = []
    without_clearance: list[float] = []
    with_clearance: list[float] = []
    for number in range(scenarios + 1):
        state = environment.reset(scenario_key(0, number))
        for _ in range(CYCLES):
            # Many small arrays, as another simulator would report them.
            reported = jax.device_get(environment.state_of(state))
            started = time.perf_counter()
            state = environment.begin(reported)
            environment.observe(state)
            observed = time.perf_counter()
            state, issued = stack(environment, policy, state)
            environment.observe(state)  # waits until all work is done
            decided = time.perf_counter()
            if number:  # the first scenario compiles
                observing.append(1e6 * (observed - started))
                times = with_clearance if issued.instructions else without_clearance
                times.append(1e6 * (decided - observed))
            state, outcome = environment.advance(state)
            if outcome.ended:
                break
    setup = f"policy `{name}` in numpy, two aircraft, {scenarios} scenarios; "
    decision = setup + "`skystack.stacking.stack`, all queries of a cycle"
    return [
        Figure("traffic to observation", "us", tuple(observing), setup + "`PlainTask.begin`"),
        Figure("stacked decision, no clearance", "us", tuple(without_clearance), decision),
        Figure("stacked decision, one clearance", "us", tuple(with_clearance), decision),
    ]
