"""The verb `flight-school`: an hour of Flight School traffic per seed, under any controller."""

import argparse
import shlex
import time
from pathlib import Path
from typing import Any

from skystack.cli.output import DONE, FAILED, print_json, program, quoted, report_error, say

OPTIONS = {
    "traffic": "category",
    "platform": "skystack",
    "seeds": 5,
    "first_seed": 0,
    "strict": False,
    "per_cycle": None,
    "uncertainty": False,
    "safety_net": True,
    "time_limit": 60,
    "cycles": 600,
    "out": Path("runs/flight-school"),
    "json": False,
}
"""The options and their defaults."""


def flight_school(options: argparse.Namespace) -> int:
    from skystack.cli.console import count_scenarios, output
    from skystack.evaluation.flight_school import fly_flight_school
    from skystack.evaluation.traffic_conditions import TrafficConditions, traffic_name
    from skystack.reporting.flight_school_table import flight_school_table

    started = time.monotonic()
    conditions = TrafficConditions(
        traffic=traffic_name(options.traffic),
        per_cycle=options.per_cycle,
        cycles=options.cycles,
        uncertainty=options.uncertainty,
        safety_net=options.safety_net,
        platform=options.platform,
    )
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    total = options.seeds * options.cycles
    counting = count_scenarios(f"{options.agent}, {options.traffic}", total, "cycles")
    try:
        with counting as on_cycle:
            result = fly_flight_school(
                options.agent,
                conditions,
                seeds,
                options.out,
                options.time_limit,
                lambda flown, to_fly: on_cycle(flown + total - to_fly),
            )
    except KeyboardInterrupt:
        text = f"interrupted; to resume: {_again(options)}"
        raise KeyboardInterrupt(text) from None
    if result.cached:
        say(f"already flown: {result.cached} of {options.seeds} seeds")
    if result.outdated:
        say(
            f"flown again: {result.outdated} seeds, because the controller, the conditions or "
            "skystack have changed"
        )
    if options.json:
        row: dict[str, Any] = result.row
        printed = {"rows": [row], "train": [], "wall_s": time.monotonic() - started}
        print_json(printed | ({"failed": result.failed} if result.failed else {}))
    else:
        output().print(flight_school_table(result.row, options.strict).as_rich())
    say(f"written: {result.folder}")
    say(f"to see the flights: {program()} replay {quoted(result.folder)} -o replay.html")
    for seed, reason in sorted(result.failed.items()):
        report_error(f"{options.agent}: seed {seed}, {reason}", FAILED)
    return FAILED if result.failed else DONE


def _again(options: argparse.Namespace) -> str:
    """The command line that resumes the same work."""
    words = ["skystack", "flight-school", options.agent]
    for name, default in OPTIONS.items():
        value = getattr(options, name)
        if value != default:
            words.append(f"--{'no-' * (default is True)}{name.replace('_', '-')}")
            words += [] if isinstance(value, bool) else [str(value)]
    return shlex.join(words)
