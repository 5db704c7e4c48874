"""A hand-written rule as a policy, with and without online action-stacking.

The rule: turn whoever points more than eight degrees off the next fix by ten degrees towards it, or
towards the fix after it when the next one is near. It sees what is cleared, so that stacking makes
its steps one clearance, issued at once. What it looks at is chosen by the task's settings.
"""

import argparse

import gymnasium
import numpy as np

import skystack.gym  # noqa: F401  (registers the environments)
from skystack.gym.stacked import MOST_INSTRUCTIONS, StackedEnvironment
from skystack.tasks.settings import TaskSettings

SETTINGS = TaskSettings(features=("theta_f", "theta_sf", "d_f"))


def rule(seen):
    """Action 1 turns the first aircraft left, 2 right; 3 and 4 the second; 0 says nothing."""
    for aircraft, (next_fix, fix_after, distance) in enumerate(seen.reshape(-1, 3)):
        # Shown in [0, 1]: turns of -180 to 180 degrees, distances of 0 to 100 NM.
        turn_deg = 360.0 * (fix_after if 100.0 * distance < 6.0 else next_fix) - 180.0
        if abs(turn_deg) > 8.0:
            return 1 + 2 * aircraft + int(turn_deg > 0.0)
    return 0


def fly(environment, seed):
    """One scenario to its end: how many clearances, and the metrics."""
    (seen, _), over, clearances = environment.reset(seed=seed), False, 0
    while not over:
        seen, _, terminated, truncated, info = environment.step(rule(seen))
        clearances += "clearance" in info and info["clearance"]["instructions"] > 0
        over = terminated or truncated
    return clearances, info


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenarios", type=int, default=20)
    options = parser.parse_args()
    plain = gymnasium.make("skystack/Lateral-v0", settings=SETTINGS)
    for title, limit in (("one at a time", 1), ("stacked", MOST_INSTRUCTIONS)):
        environment = StackedEnvironment(plain, limit)
        flown = [fly(environment, seed) for seed in range(options.scenarios)]
        clearances = np.mean([count for count, _ in flown])
        success = np.mean([info["success"] for _, info in flown])
        print(f"{title}: {clearances:.1f} clearances a scenario, success {success:.0%}")


if __name__ == "__main__":
    main()
