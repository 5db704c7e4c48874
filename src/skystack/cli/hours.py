"""`evaluate` with `--traffic`: hours of arriving traffic under a controller of a sector."""

import argparse
import time
from collections.abc import Mapping
from typing import Any

from skystack.cli.output import DONE, print_json, program, quoted, say
from skystack.cli.values import positive
from skystack.errors import InputError

_ONLY_SCENARIOS = {
    "experiment": None,
    "stacking": True,
    "sample": False,
    "time_limit": 120,
}
"""The options that make no sense with hours of traffic, and their defaults."""
ONLY_TRAFFIC = {"per_cycle": None, "uncertainty": False, "safety_net": True}
"""The options that are only for hours of traffic, and their defaults."""


def controller_arguments(sub: argparse.ArgumentParser, when: str = "") -> None:
    """The options of a controller of a sector; `when` says when they are allowed."""
    sub.add_argument(
        "--per-cycle",
        type=positive,
        metavar="N",
        help=f"{when}maximum number of transmissions in a radar cycle (default 5; no limit for "
        "module:Class)",
    )
    sub.add_argument(
        "--uncertainty",
        action="store_true",
        help=f"{when}change speeds by up to 3 %%, which controllers observe, and rates of "
        "climb and descent by up to 10 %%, which they do not",
    )
    sub.add_argument(
        "--no-safety-net",
        dest="safety_net",
        action="store_false",
        help=f"{when}fly a policy without its safety net",
    )


def check_unused(options: argparse.Namespace, defaults: Mapping[str, Any], problem: str) -> None:
    """Raise InputError for an option of `evaluate` that is not at its default."""
    for name, default in defaults.items():
        if getattr(options, name) != default:
            no = "no-" if default is True else ""
            raise InputError(f"evaluate: --{no}{name.replace('_', '-')} {problem}")


def check_scenarios(name: str, policy: Any = None) -> None:
    """Raise InputError for an agent of sector control, which needs hours of traffic.

    `policy` is the agent that was found by the name.
    """
    from skystack.agents.sector_agents import SECTOR_AGENTS
    from skystack.learning.policy import Policy
    from skystack.tasks.sector_control import SectorControl

    controls = isinstance(policy, Policy) and policy.description.task_name == SectorControl.name
    if controls or (policy is None and name in SECTOR_AGENTS):
        raise InputError(
            f"evaluate: {name} controls a whole sector (allowed: with --traffic, such as "
            "--traffic 60)"
        )


def evaluate_hours(options: argparse.Namespace) -> int:
    from skystack.cli.console import count_scenarios, output
    from skystack.compilation.programs import program_cache
    from skystack.evaluation.traffic import evaluate_traffic, hours_folder
    from skystack.evaluation.traffic_conditions import TrafficConditions, cycles_of, traffic_name
    from skystack.reporting.hour_table import hour_table

    check_unused(options, _ONLY_SCENARIOS, "cannot be used with --traffic")
    started = time.monotonic()
    hours = 1 if options.episodes is None else options.episodes
    traffic = traffic_name(options.traffic)
    conditions = TrafficConditions(
        traffic=traffic,
        hours=hours,
        seed=options.seed,
        per_cycle=options.per_cycle,
        sector=options.sector,
        uncertainty=options.uncertainty,
        safety_net=options.safety_net,
        platform=options.platform,
        cycles=cycles_of(traffic, options.cycles),
    )
    total = hours * conditions.cycles
    counting = count_scenarios(
        f"{options.policy}, traffic {conditions.recorded_traffic}", total, "cycles"
    )
    with program_cache(), counting as on_cycle:
        row: dict[str, Any] = evaluate_traffic(options.policy, conditions, options.out, on_cycle)
    wall_s = time.monotonic() - started
    if options.json:
        print_json({"rows": [row], "rows_by_seed": [row], "train": [], "wall_s": wall_s})
    else:
        output().print(hour_table(row).as_rich())
    if options.out is not None:
        folder = hours_folder(options.out, row["agent"], conditions)
        say(f"written: {folder}")
        say(f"to see the flights: {program()} replay {quoted(folder)} -o replay.html")
    return DONE
