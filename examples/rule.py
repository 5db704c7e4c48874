"""A hand-written rule as a policy, without and with online action-stacking.

The rule turns an aircraft by 10 degrees if it points more than 8 degrees off its next fix, or off
the fix after that if the next one is near. Observed turns are relative to the cleared heading, so
stacking compiles all turns of a cycle into one clearance. `SETTINGS` selects the observed features
that the rule needs.
"""

import argparse

import gymnasium
import numpy as np

import skystack.gym  # noqa: F401  (registers the environments)
from skystack.gym.stacked import DEFAULT_LIMIT, StackedEnvironment
from skystack.tasks.settings import NavigationSettings

SETTINGS = NavigationSettings(features=("theta_f", "theta_sf", "d_f"))


def rule(observation):
    """Action 1 turns the first aircraft left, 2 right; 3 and 4 the second; 0 issues nothing."""
    for aircraft, (next_fix, fix_after, distance) in enumerate(observation.reshape(-1, 3)):
        # Turns of -180 to 180 degrees and distances of 0 to 100 NM are scaled to [0, 1].
        turn_deg = 360.0 * (fix_after if 100.0 * distance < 6.0 else next_fix) - 180.0
        if abs(turn_deg) > 8.0:
            return 1 + 2 * aircraft + int(turn_deg > 0.0)
    return 0


def fly(environment, seed):
    """Fly one scenario to its end. Returns the number of clearances and the final `info`."""
    (observation, _), ended, clearances = environment.reset(seed=seed), False, 0
    while not ended:
        observation, _, terminated, truncated, info = environment.step(rule(observation))
        clearances += "clearance" in info and info["clearance"]["instructions"] > 0
        ended = terminated or truncated
    return clearances, info


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenarios", type=int, default=20)
    options = parser.parse_args()
    plain = gymnasium.make("skystack/Lateral-v0", settings=SETTINGS)
    for title, limit in (("one at a time", 1), ("stacked", DEFAULT_LIMIT)):
        environment = StackedEnvironment(plain, limit)
        flown = [fly(environment, seed) for seed in range(options.scenarios)]
        clearances = np.mean([count for count, _ in flown])
        success = np.mean([info["success"] for _, info in flown])
        print(f"{title}: {clearances:.1f} clearances per scenario, success {success:.0%}")


if __name__ == "__main__":
    main()
