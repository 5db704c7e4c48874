"""The paper's method and its neighbours: frame skip, FiGAR, TempoRL, options, absolute clearances.

    python -m studies.neighbours [PROBLEM ...] [--method METHOD ...] [--seeds 5] [--json]
        [--out DIR]

Trains every method on every problem (lateral, vertical, avoidance) with the same rewards and
budget, and evaluates it on the same 1,000 held-out scenarios. Prints a Markdown table for each
problem, and one for stacking itself: only in training, only at inference, in both, in neither.
`docs/neighbours.md` lists what else is equal and what is not. Finished work in DIR is reused, so
the command can be interrupted and repeated.
"""

import argparse
import json
import sys
from pathlib import Path

from skystack.errors import InputError, check_known, checked_integer, unknown_name
from studies.neighbours.compare import run, stacking_table, table
from studies.neighbours.methods import METHODS, PROBLEMS


def main() -> int:
    """Returns the exit code: 0 success, 2 invalid input."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.neighbours",
        description=(__doc__ or "").partition("\n")[0],
        epilog=f"methods: {', '.join(METHODS)}",
    )
    parser.add_argument(
        "problems", nargs="*", metavar="PROBLEM", help=f"{', '.join(PROBLEMS)} (default: all)"
    )
    parser.add_argument(
        "--method",
        action="append",
        default=[],
        help="a method to train; may be repeated (default: all)",
    )
    parser.add_argument("--seeds", type=int, default=5, help="seeds per method (default 5)")
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/neighbours"),
        help="folder for results (default runs/neighbours)",
    )
    options = parser.parse_args()
    try:
        check_known("problem", options.problems, PROBLEMS)
        check_known("method", options.method, METHODS)
        checked_integer("--seeds", options.seeds, 1)
        problems, methods = options.problems or list(PROBLEMS), options.method or list(METHODS)
        for problem in problems:
            if not set(methods) & set(PROBLEMS[problem].methods):
                raise unknown_name(f"method for {problem}", methods[0], PROBLEMS[problem].methods)
        results = run(problems, methods, options.seeds, options.out)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    if options.json:
        named = {" / ".join(key): found for key, found in results.items()}
        sys.stdout.write(json.dumps(named) + "\n")
        return 0
    for problem in problems:
        sys.stdout.write(f"{problem}\n\n{table(problem, results).as_markdown()}\n")
        stacking = stacking_table(problem, results)
        if stacking.rows:
            sys.stdout.write(f"{stacking.as_markdown()}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
