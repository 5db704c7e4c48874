"""A hand-written rule, evaluated exactly as trained policies are, one at a time and stacked.

    python examples/judged_rule.py --scenarios 1000 --out evaluation
    skystack replay evaluation/aim-s0-skystack-stacked

writes the tables and replays what was flown. `--platform bluebird` flies it in BluebirdDT, where
that is installed.
"""

import argparse
from pathlib import Path

import skystack
from skystack.learning.experiment import Experiment
from skystack.tasks.settings import TaskSettings

EXPERIMENT = Experiment("aimed", task=TaskSettings(features=("theta_f", "theta_sf", "d_f")))


def aim(observation):
    """Turns an aircraft that points more than 8 degrees off its next fix by ten degrees.

    Action 1 turns the first aircraft left, 2 right; 3 and 4 the second; 0 issues nothing.
    """
    for aircraft, (next_fix, fix_after, distance) in enumerate(observation.reshape(-1, 3)):
        # Observed in [0, 1]: turns of -180 to 180 degrees, distances of 0 to 100 NM.
        turn_deg = 360.0 * (fix_after if 100.0 * distance < 6.0 else next_fix) - 180.0
        if abs(turn_deg) > 8.0:
            return 1 + 2 * aircraft + int(turn_deg > 0.0)
    return 0


if __name__ == "__main__":  # other platforms fly in processes that import this file
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--scenarios", type=int, default=20)
    parser.add_argument("--platform", default="skystack")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    for title, stacking in (("one at a time", False), ("stacked", True)):
        conditions = skystack.Conditions(
            episodes=options.scenarios, stacking=stacking, platform=options.platform
        )
        row = skystack.judge(aim, conditions, options.out, experiment=EXPERIMENT).row
        print(
            f"{title}: {row['clearances_mean']:.1f} clearances a scenario, "
            f"success {row['success_rate']:.0%}"
        )
