"""The verb `flight-school`: an hour of Flight School traffic per seed, under any controller."""

import argparse
import shlex
import time
from pathlib import Path
from typing import Any

from skystack.cli.hours import ONLY_TRAFFIC, controller_arguments
from skystack.cli.output import DONE, FAILED, print_json, program, quoted, report_error, say
from skystack.cli.values import cycles_argument, natural, platform_argument, positive

SEEDS = 5
OPTIONS: dict[str, Any] = {
    "traffic": "category",
    "platform": "skystack",
    "seeds": None,
    "first_seed": 0,
    "strict": False,
    **ONLY_TRAFFIC,
    "time_limit": 60,
    "cycles": None,
    "out": Path("runs/flight-school"),
    "json": False,
}
"""The options and their defaults."""


def flight_school_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "agent",
        metavar="AGENT",
        help="no-op, own-navigation, own-navigation-exit-level, rules, search, mvp (in BlueSky), a "
        "shipped policy (sector-control), a run folder, a file (.onnx, .zip), or your own "
        "module:Class or file.py:Class, whose code is executed",
    )
    sub.add_argument(
        "--traffic",
        metavar="TRAFFIC",
        help="category (default), notebook or environment, a number of flights per hour, "
        "springfield:SCENARIO, an experiment, or a scenario file (.json)",
    )
    platform_argument(sub)
    sub.add_argument(
        "--seeds", type=positive, metavar="N", help="number of hours (default 5; Springfield 1)"
    )
    sub.add_argument("--first-seed", type=natural, metavar="N", help="first seed (default 0)")
    sub.add_argument(
        "--strict",
        action="store_true",
        help="show survival by the strict score, which also ends with an exit at a wrong level",
    )
    controller_arguments(sub)
    sub.add_argument(
        "--time-limit",
        type=positive,
        metavar="S",
        help="limit for each radar cycle after the first, in seconds of real time, including the "
        "decision (default 60)",
    )
    cycles_argument(sub, "600, an hour; for a scenario, its length", None)
    sub.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of all results; finished seeds are not flown again (default "
        "runs/flight-school)",
    )
    sub.set_defaults(**OPTIONS)


def flight_school(options: argparse.Namespace) -> int:
    from skystack.cli.console import count_scenarios, output
    from skystack.evaluation.flight_school import fly_flight_school
    from skystack.evaluation.traffic_conditions import TrafficConditions, cycles_of, traffic_name
    from skystack.reporting.flight_school_table import flight_school_table

    started = time.monotonic()
    traffic = traffic_name(options.traffic)
    conditions = TrafficConditions(
        traffic=traffic,
        per_cycle=options.per_cycle,
        cycles=cycles_of(traffic, options.cycles),
        uncertainty=options.uncertainty,
        safety_net=options.safety_net,
        platform=options.platform,
    )
    count = options.seeds or (1 if conditions.is_the_same_for_every_seed else SEEDS)
    seeds = range(options.first_seed, options.first_seed + count)
    total = count * conditions.cycles
    counting = count_scenarios(f"{options.agent}, {conditions.recorded_traffic}", total, "cycles")
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
        say(f"already flown: {result.cached} of {count} seeds")
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
    for failure in result.failures:
        report_error(f"{options.agent}: {failure}", FAILED)
    return FAILED if result.failed else DONE


def _again(options: argparse.Namespace) -> str:
    """The command line that resumes the same work."""
    words = ["flight-school", options.agent]
    for name, default in OPTIONS.items():
        value = getattr(options, name)
        if value != default:
            words.append(f"--{'no-' * (default is True)}{name.replace('_', '-')}")
            words += [] if isinstance(value, bool) else [str(value)]
    return f"{program()} {shlex.join(words)}"
