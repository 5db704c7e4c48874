"""What the paper's reward pays for instructions: policies judged by return, not by count.

Flies shipped policies that see the paper's state on the evaluation scenarios, and reports the mean
return under the weights of the paper's "Lateral Navigation" row. A policy with fewer instructions
and a lower return shows that the reward does not ask for fewer.

    python -m studies.paper_reward [POLICY ...]      default: lateral lateral-tuned
"""

import json
import sys

import numpy as np

from skystack.errors import InputError
from skystack.evaluation.rollout import fly, network_controller
from skystack.policies.shipped import find_policy
from skystack.tasks.build import build_task
from skystack.tasks.settings import TaskSettings

SCENARIOS = 1000


def judge_by_return(name: str) -> dict[str, float | str]:
    """Mean return and instructions of a policy, plain and stacked, under the paper's weights."""
    policy = find_policy(name)
    task = build_task(TaskSettings())
    if policy.description.observation != task.observation_names:
        raise InputError(f"policy {name!r} does not see the paper's state")
    controller = network_controller(policy.actor, policy.normaliser, greedy=True)
    found: dict[str, float | str] = {"policy": name}
    for stacking in (False, True):
        kind = "stacked" if stacking else "plain"
        flight = fly(task, controller, 0, SCENARIOS, stacking)
        found[f"return_{kind}"] = float(np.mean(np.sum(flight.reward, axis=1)))
        found[f"instructions_{kind}"] = float(np.mean(np.sum(flight.instructions, axis=1)))
    return found


def main() -> int:
    """Print one JSON object a policy; returns the exit code."""
    try:
        for name in sys.argv[1:] or ["lateral", "lateral-tuned"]:
            sys.stdout.write(json.dumps(judge_by_return(name)) + "\n")
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
