"""A hand-written rule, evaluated like a trained policy, without and with stacking.

    python examples/evaluated_rule.py --scenarios 1000 --out evaluation
    skystack replay evaluation/aim-s0-skystack-stacked

These commands write the tables and replay the flights. With `--platform bluebird`, the aircraft fly
in BluebirdDT, if it is installed.
"""

import argparse
from pathlib import Path

import skystack
from skystack.learning.experiment import Experiment
from skystack.tasks.settings import NavigationSettings

EXPERIMENT = Experiment("aimed", task=NavigationSettings(features=("theta_f", "theta_sf", "d_f")))


def aim(observation):
    """Turn an aircraft by 10 degrees if it points more than 8 degrees off its next fix.

    Action 1 turns the first aircraft left, 2 right; 3 and 4 the second; 0 issues nothing.
    """
    for aircraft, (next_fix, fix_after, distance) in enumerate(observation.reshape(-1, 3)):
        # Turns of -180 to 180 degrees and distances of 0 to 100 NM are scaled to [0, 1].
        turn_deg = 360.0 * (fix_after if 100.0 * distance < 6.0 else next_fix) - 180.0
        if abs(turn_deg) > 8.0:
            return 1 + 2 * aircraft + int(turn_deg > 0.0)
    return 0


if __name__ == "__main__":  # processes of other platforms import this file
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--scenarios", type=int, default=20)
    parser.add_argument("--platform", default="skystack")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    for title, stacking in (("one at a time", False), ("stacked", True)):
        conditions = skystack.Conditions(
            episodes=options.scenarios, stacking=stacking, platform=options.platform
        )
        row = skystack.evaluate(aim, conditions, options.out, experiment=EXPERIMENT).row
        print(
            f"{title}: {row['clearances_mean']:.1f} clearances per scenario, "
            f"success {row['success_rate']:.0%}"
        )
