"""Whether the paper's reward favours few instructions: policies compared by their return.

Flies shipped policies that observe the paper's state on the evaluation scenarios, and prints the
mean return under the weights of the paper's "Lateral Navigation" row. A policy with fewer
instructions and a lower return shows that the reward does not favour few instructions.

    python -m studies.paper_reward [POLICY ...]      default: lateral lateral-tuned
"""

import json
import sys

import numpy as np

from skystack.errors import InputError
from skystack.evaluation.rollout import fly, network_controller
from skystack.policies.shipped import find_policy
from skystack.tasks.registry import build_traffic_task
from skystack.tasks.settings import NavigationSettings

SCENARIOS = 1000


def returns_of(name: str) -> dict[str, float | str]:
    """Mean return and instructions of a policy, plain and stacked, under the paper's weights."""
    policy = find_policy(name)
    task = build_traffic_task(NavigationSettings())
    if policy.description.observation != task.observation_names:
        raise InputError(f"policy {name!r} does not observe the paper's state")
    controller = network_controller(policy.actor, policy.normaliser, greedy=True)
    found: dict[str, float | str] = {"policy": name}
    for stacking in (False, True):
        kind = "stacked" if stacking else "plain"
        flight = fly(task, controller, 0, SCENARIOS, stacking)
        found[f"return_{kind}"] = float(np.mean(np.sum(flight.reward, axis=1)))
        found[f"instructions_{kind}"] = float(np.mean(np.sum(flight.instructions, axis=1)))
    return found


def main() -> int:
    """Print one JSON object per policy; returns the exit code."""
    try:
        for name in sys.argv[1:] or ["lateral", "lateral-tuned"]:
            sys.stdout.write(json.dumps(returns_of(name)) + "\n")
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
