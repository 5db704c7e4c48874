"""The verb `reproduce`, and how the results of a run are printed.

Like the other verbs, it imports what it needs when it is called.
"""

import argparse
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from skystack.cli.output import (
    DONE,
    FAILED,
    print_json,
    print_line,
    program,
    quoted,
    report_error,
    say,
)
from skystack.errors import InputError


def reproduce(options: argparse.Namespace) -> int:
    from skystack.io.locks import locked_folder
    from skystack.reproduction.plan import OWN_FOLDERS

    plan, engine = _plan(options), _engine(options)
    with locked_folder(plan.out, OWN_FOLDERS):
        try:
            return _reproduce(plan, engine, options.json)
        except KeyboardInterrupt:
            raise KeyboardInterrupt("interrupted; the same command resumes") from None


def _plan(options: argparse.Namespace) -> Any:
    from skystack.reproduction.plan import QUICK_EPISODES, make_plan

    quick, families = options.quick, options.families
    name = "-".join([*(families or ["first-look"]), *["quick"] * quick])
    out = options.out or Path("runs") / name
    seeds, platforms = options.seeds, options.platforms
    episodes = options.episodes or (QUICK_EPISODES if quick else 1000)
    words = ["skystack", "reproduce", *families]
    words += ["--seeds", str(seeds), "--episodes", str(episodes)]
    words += ["--engine ray"] * (options.engine == "ray")
    words += ["--quick"] * quick + [f"--platform {name}" for name in platforms]
    command = " ".join(words)
    return make_plan(families, seeds, episodes, out, quick, command, platforms)


def _reproduce(plan: Any, engine: Any, as_json: bool) -> int:
    from skystack.cli.console import count_scenarios, show_progress
    from skystack.compilation.programs import compile_for_cores, program_cache
    from skystack.platforms.registry import platform_notes
    from skystack.reporting.report import write_report
    from skystack.reproduction.jobs import jobs_of
    from skystack.reproduction.plan import describe_plan
    from skystack.reproduction.run import run_plan, run_platforms

    for line in describe_plan(plan):
        say(line)
    compile_for_cores(1)
    with program_cache(), show_progress(len(jobs_of(plan))) as report:
        results = run_plan(plan, report, engine)
    if results["kept"]:
        count = len(results["kept"])
        say(f"reused {count} cached result{'s' * (count != 1)} of an earlier run")
    say("writing figures and report ...")
    path = write_report(plan.out)
    failed: list[str] = []
    if plan.platforms:
        for line in (line for name in plan.platforms for line in platform_notes(name)):
            say(line)
        failed = run_platforms(plan, results, count_scenarios)
        write_report(plan.out)
    show_results(plan.out, results, as_json)
    say(f"{results['wall_s']:.0f} s; report: {path}")
    for page in sorted(plan.out.glob("replay-*.html")):
        say(f"replay of one scenario: {page}")
    if (flown := _best_flown(plan)) is not None:
        say(f"to replay more scenarios: {program()} replay {quoted(flown)} -o replay.html")
    for line in failed:
        report_error(line, FAILED)
    return FAILED if failed else DONE


def _best_flown(plan: Any) -> Path | None:
    """The evaluation to look at first: stacked, of the last policy in the order of the tables."""
    from skystack.reporting.results import read_run

    run = read_run(plan.out)
    drawn = run.results.drawn(run.results.rows)
    rows = [row for row in drawn if row.stacking and not row.is_shipped]
    return run.evaluation(rows[-1]) if rows else None


def _engine(options: argparse.Namespace) -> Any:
    from skystack.reproduction.cluster import run_on_cluster
    from skystack.reproduction.processes import run_in_processes

    if options.engine == "ray":
        return partial(run_on_cluster, address=options.ray_address)
    if options.ray_address:
        raise InputError("reproduce: --ray-address is for --engine ray")
    return run_in_processes


def show_results(folder: Path, results: Mapping[str, Any], as_json: bool) -> None:
    """Print the results of a run folder: a table for each family and the result in a sentence."""
    from skystack.cli.console import output
    from skystack.reporting.families import family_title
    from skystack.reporting.headline import headline
    from skystack.reporting.results import read_run
    from skystack.reporting.tables import brief, platforms

    if as_json:
        keys = ["rows", "rows_by_seed", "comparisons", "train", "wall_s"]
        keys += [name for name in ("sampled", "platforms") if results.get(name)]
        print_json({key: results[key] for key in keys if key in results})
        return
    run = read_run(folder)
    for family, rows in run.results.families.items():
        print_line(family_title(family))
        output().print(brief(rows, run.bound_of(family), run.results.is_trained).as_rich())
    print_line("Exit offset: mean distance from the exit fix when crossing the exit, in NM.")
    if "avoidance" in run.results.families:
        print_line("Loss rate: share of scenarios with a loss of separation.")
    if run.results.platforms:
        output().print(platforms(run.results.platforms).as_rich())
    for sentence in headline(run):
        output().print(sentence)
