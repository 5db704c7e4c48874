"""Check shipped policies in BluebirdDT and BlueSky.

Flies policies on the evaluation scenarios in the three simulators. Required with stacking: in
BluebirdDT the same clearances as in skystack in at least 95 % of the scenarios, success within
0.02 and mean clearances within 5 %; in BlueSky success of at least 0.95. Needs both extras.

    python -m studies.policies_on_platforms [POLICY ...]      default: lateral lateral-tuned

Prints a JSON object per row; exit code 1 if a stacked row does not meet the requirements.
"""

import json
import sys
import tempfile
from pathlib import Path

from skystack.cli.console import count_scenarios
from skystack.errors import InputError, PlatformError
from skystack.evaluation.cross_platform import evaluate_on_platforms
from skystack.evaluation.summary import RowValues
from skystack.policies.shipped import find_policy

SCENARIOS = 100
KEYS = ("experiment", "stacking", "platform", "clearances_mean", "success_rate", "wall_s")


def holds(ours: RowValues, theirs: RowValues) -> bool:
    """Whether a stacked row of another simulator meets the requirements."""
    if theirs["platform"] == "bluesky":
        return bool(theirs["success_rate"] >= 0.95)
    apart = abs(theirs["clearances_mean"] / ours["clearances_mean"] - 1.0)
    return bool(
        theirs["same_clearances_rate"] >= 0.95
        and abs(theirs["success_rate"] - ours["success_rate"]) <= 0.02
        and apart <= 0.05
    )


def main(arguments: list[str]) -> int:
    """Fly, print and check; returns the exit code."""
    all_hold = True
    try:
        for name in arguments or ["lateral", "lateral-tuned"]:
            policy = find_policy(name)
            with tempfile.TemporaryDirectory() as folder:
                found = evaluate_on_platforms(
                    policy, ("bluebird", "bluesky"), SCENARIOS, Path(folder), count_scenarios
                )
            ours = {row["stacking"]: row for row in found.rows if row["platform"] == "skystack"}
            for row in found.rows:
                line = {key: row[key] for key in KEYS}
                if row["platform"] != "skystack":
                    line["same_clearances_rate"] = row["same_clearances_rate"]
                    line["holds"] = holds(ours[row["stacking"]], row)
                    all_hold &= line["holds"] or not row["stacking"]
                sys.stdout.write(json.dumps(line) + "\n")
            all_hold &= not found.failed
    except (InputError, PlatformError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0 if all_hold else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
