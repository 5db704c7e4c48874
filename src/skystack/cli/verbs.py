"""The functions of the verbs except `reproduce`. Each imports what it needs when it is called."""

import argparse
import json
import shlex
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from skystack.cli.hours import ONLY_TRAFFIC, check_scenarios, check_unused, evaluate_hours
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
from skystack.cli.reproduce import show_results
from skystack.errors import InputError


def list_all(options: argparse.Namespace) -> int:
    from skystack.cli.catalogue import catalogue, catalogue_table
    from skystack.cli.console import output

    found = catalogue()
    if options.json:
        print_json(found)
    else:
        for table in catalogue_table(found):
            output().print(table)
    return DONE


def train(options: argparse.Namespace) -> int:
    from skystack.io.locks import delete_empty_on_failure
    from skystack.learning.experiment import load_experiment

    cycles = [] if options.cycles is None else [f"task.cycles={options.cycles}"]
    experiment = load_experiment(options.experiment, [*options.changes, *cycles])
    out = options.out or Path("runs") / f"{experiment.name}-s{options.seed}"
    with delete_empty_on_failure(out):
        return _train(options, experiment, out)


def _train(options: argparse.Namespace, experiment: Any, out: Path) -> int:
    from skystack.cli.console import show_progress
    from skystack.compilation.programs import program_cache
    from skystack.learning.event_files import event_files
    from skystack.learning.parts import prepare_process
    from skystack.learning.progress import TrainingProgress
    from skystack.learning.run import CHECKPOINT_EVERY_S, preflight, train_experiment
    from skystack.policies.shipped import SECTOR_CONTROL
    from skystack.tasks.registry import build_training_task

    name, every_s = f"{experiment.name}-s{options.seed}", options.checkpoint_every
    events = event_files(out) if options.tensorboard else nullcontext(lambda: None)
    for line in preflight(experiment, out, options.resume):
        say(line)
    prepare_process(build_training_task(experiment.task))
    try:
        with program_cache(), events as follow, show_progress() as report:

            def on_update(step: TrainingProgress) -> None:
                report(name, step)
                follow()

            trained = train_experiment(
                experiment, options.seed, out, options.resume, on_update, every_s
            )
    except KeyboardInterrupt:
        words = ["train", options.experiment, "--seed", str(options.seed)]
        words += ["--out", str(out), "--resume"]
        words += ["--tensorboard"] * options.tensorboard
        words += ["--checkpoint-every", str(every_s)] * (every_s != CHECKPOINT_EVERY_S)
        words += ["--cycles", str(options.cycles)] * (options.cycles is not None)
        words += [word for change in options.changes for word in ("--set", change)]
        again = f"{program()} {shlex.join(words)}"
        raise KeyboardInterrupt(f"interrupted; to resume: {again}") from None
    say(f"{trained.wall_s:.0f} s; policy: {out / 'policy.json'}")
    hours = experiment.task.name == SECTOR_CONTROL
    what = "on an hour of traffic" if hours else "stacked, on held-out scenarios"
    traffic = " --traffic 60" if hours else ""
    say(f"to evaluate it, {what}: {program()} evaluate {quoted(out)}{traffic}")
    if options.json:
        summary = [trained.summary]
        print_json({"rows": [], "rows_by_seed": [], "train": summary, "wall_s": trained.wall_s})
    return DONE


def evaluate(options: argparse.Namespace) -> int:
    from skystack.agents.find import find_agent
    from skystack.cli.console import count_scenarios, output
    from skystack.compilation.programs import compile_for_cores, program_cache
    from skystack.evaluation.evaluate import Conditions, evaluate
    from skystack.evaluation.summary import aggregate, evaluation_folder
    from skystack.reporting.tables import one_row

    if options.traffic is not None:
        return evaluate_hours(options)
    check_unused(options, ONLY_TRAFFIC, "needs --traffic")
    check_scenarios(options.policy)
    started = time.monotonic()
    episodes = 1000 if options.episodes is None else options.episodes
    conditions = Conditions(
        seed=options.seed,
        episodes=episodes,
        stacking=options.stacking,
        greedy=not options.sample,
        platform=options.platform,
        time_limit_s=options.time_limit,
        sector=options.sector,
        cycles=options.cycles,
    )
    policy = find_agent(options.policy)
    check_scenarios(options.policy, policy)
    compile_for_cores(1)
    way = "stacked" if options.stacking else "unstacked"
    counting = count_scenarios(f"{options.policy}, {way}", episodes)
    with program_cache(), counting as on_scenario:
        evaluated = evaluate(
            policy, conditions, options.out, on_scenario, experiment=options.experiment
        )
    for line in evaluated.notes:
        say(line)
    rows = [aggregate([evaluated.row], [evaluated.episodes])]
    if options.json:
        wall_s = time.monotonic() - started
        result = {"rows": rows, "rows_by_seed": [evaluated.row], "train": [], "wall_s": wall_s}
        print_json(result | ({"failed": evaluated.failed} if evaluated.failed else {}))
    else:
        output().print(one_row(rows[0]).as_rich())
    if options.out is not None:
        row = evaluated.row
        folder = evaluation_folder(
            options.out,
            row["experiment"],
            row["seed"],
            row["stacking"],
            row["platform"],
            row["greedy"],
        )
        say(f"written: {folder}")
        say(f"to see the flights: {program()} replay {quoted(folder)} -o replay.html")
    for number, reason in evaluated.failed.items():
        report_error(f"{options.platform}: scenario {number} {reason}", FAILED)
    return FAILED if evaluated.failed else DONE


def report(options: argparse.Namespace) -> int:
    from skystack.evaluation.hour_row import folders_of_hours
    from skystack.reporting.report import write_report
    from skystack.reporting.trainings import is_reproduction

    first, *others = options.runs
    if any(folders_of_hours(each) for each in options.runs):
        return _report_hours(options)
    if others or not is_reproduction(first):
        return _compare(options)
    if options.output:
        raise InputError(
            f"report: -o is for comparisons; the report of {first} is always in its folder"
        )
    path = write_report(first)
    show_results(first, json.loads((first / "results.json").read_bytes()), options.json)
    say(f"report: {path}")
    return DONE


def _page_of(options: argparse.Namespace, default: str) -> Path:
    """The page to write. Raises InputError for another kind of file."""
    path: Path = options.output or Path(default)
    if path.suffix not in (".html", ".htm"):
        raise InputError(f"report: -o {path} (allowed: .html)")
    return path


def _report_hours(options: argparse.Namespace) -> int:
    import msgspec

    from skystack.cli.console import output
    from skystack.reporting.hours_report import REPORT, hours_table, read_hours, write_hours_report

    path = _page_of(options, REPORT)
    rows = read_hours(options.runs)
    write_hours_report(rows, path)
    if options.json:
        print_json({"rows": msgspec.to_builtins(rows)})
    else:
        output().print(hours_table(rows).as_rich())
    say(f"report: {path}")
    return DONE


def _compare(options: argparse.Namespace) -> int:
    from skystack.cli.console import output
    from skystack.reporting.comparison import comparison_json, comparison_tables, write_comparison
    from skystack.reporting.trainings import read_runs

    path = _page_of(options, "comparison.html")
    runs = read_runs(options.runs)
    write_comparison(runs, path)
    if options.json:
        print_json(comparison_json(runs))
    else:
        for table in comparison_tables(runs):
            output().print(table.as_rich())
    say(f"comparison: {path}")
    return DONE


def sector(options: argparse.Namespace) -> int:
    from skystack.airspace.sectors import sector_from, sector_setting
    from skystack.cli.console import output
    from skystack.reporting.sector_sheet import (
        beyond_cycles,
        facts_table,
        headlines,
        sector_facts,
        write_map,
    )

    found = sector_from(sector_setting(options.sector))
    if options.output:
        write_map(found, options.output)
        say(f"written: {options.output}")
    facts = sector_facts(found, options.cycles)
    if options.json:
        print_json(facts)
        return DONE
    for line in headlines(facts):
        print_line(line)
    output().print(facts_table(facts).as_rich())
    if (beyond := beyond_cycles(found, options.cycles)) is not None:
        print_line(beyond)
    return DONE


def replay(options: argparse.Namespace) -> int:
    from skystack.reporting.replay.film import SUFFIXES
    from skystack.reporting.replay.page import write_replay

    runs = [options.recorded] + [options.other] * (options.other is not None)
    for_pictures = {"--scenario": options.scenario, "--from": options.from_s, "--to": options.to_s}
    if options.output.suffix in SUFFIXES:
        if options.scenarios is not None:
            raise InputError("replay: --scenarios is for pages (.html)")
        return _picture(options, runs)
    if options.output.suffix not in (".html", ".htm"):
        allowed = ", ".join((".html", *SUFFIXES))
        raise InputError(f"replay: -o {options.output} (allowed: {allowed})")
    for name, value in for_pictures.items():
        if value is not None:
            raise InputError(f"replay: {name} is for pictures and films ({', '.join(SUFFIXES)})")
    written = write_replay(runs, options.output, options.scenarios)
    if options.json:
        print_json(written)
    count = written["scenarios"]
    size = f"{count} scenario{'s' * (count != 1)}, {written['bytes'] / 1e6:.1f} MB"
    say(f"written: {options.output} ({size})")
    return DONE


def _picture(options: argparse.Namespace, runs: list[Path]) -> int:
    from skystack.cli.console import prose
    from skystack.reporting.replay.film import write_picture

    number, from_s = options.scenario or 0, options.from_s or 0
    with prose().status("drawing ..."):
        written = write_picture(runs, options.output, number, from_s, options.to_s)
    if options.json:
        print_json(written)
    say(f"written: {options.output}")
    return DONE


def simulate(options: argparse.Namespace) -> int:
    from skystack.cli.console import output
    from skystack.cli.simulated import headline, losses_line, summary_table
    from skystack.evaluation.simulate import simulate_file

    summary = simulate_file(options.scenario, options.output, options.platform, options.time_limit)
    for line in summary["notes"]:
        say(line)
    if options.json:
        print_json(summary)
    else:
        print_line(headline(summary))
        output().print(summary_table(summary).as_rich())
        for clearance in summary["clearances"]:
            print_line(f"{clearance['cycle'] * 6:6d} s  {clearance['text']}")
        print_line(losses_line(summary))
    if options.output:
        say(f"written: {options.output}")
    return DONE


def export(options: argparse.Namespace) -> int:
    from skystack.export import formats

    for line in formats.export(options.source, options.format, options.scenario, options.output):
        say(line)
    say(f"written: {options.output}")
    if options.json:
        print_json({"source": options.source, "output": str(options.output)})
    return DONE


def bench(options: argparse.Namespace) -> int:
    import msgspec

    from skystack.benchmarking.display import figures_table, machine_line, number
    from skystack.benchmarking.machine import this_machine
    from skystack.benchmarking.run import QUICK, Effort, measure_skystack
    from skystack.cli.console import output

    if options.against is not None:
        return _bench_against(options)
    effort, on_part = QUICK if options.quick else Effort(), _timed_titles()
    figures = measure_skystack(effort, on_part, options.only)
    missing: dict[str, str] = {}
    speedups: dict[str, float] = {}
    if options.peers:
        from skystack.benchmarking.peers import measure_peers, ratios

        found, missing = measure_peers(effort, on_part)
        figures += found
        speedups = ratios(figures)
    if options.json:
        print_json(
            {
                "machine": msgspec.to_builtins(this_machine()),
                "figures": [figure.as_json for figure in figures],
                "ratios": speedups,
                "not_measured": missing,
            }
        )
    else:
        output().print(figures_table(figures).as_rich())
        print_line(machine_line(this_machine()))
        for name, speedup in speedups.items():
            print_line(f"{number(speedup)} times as fast as {name}")
        for name, reason in missing.items():
            print_line(f"not measured: {name}: {reason}")
    return DONE


def _bench_against(options: argparse.Namespace) -> int:
    import msgspec

    from skystack.benchmarking.display import machine_line, pairs_table
    from skystack.benchmarking.paired import compare_with
    from skystack.benchmarking.run import QUICK, Effort, groups_of, parts
    from skystack.cli.console import output

    if options.peers:
        raise InputError("--peers cannot be used with --against")
    effort = QUICK if options.quick else Effort()
    groups = groups_of(parts(effort, options.only))
    quick = ["--quick"] if options.quick else []
    compared = compare_with(options.against, groups, quick, _timed_titles())
    if options.json:
        print_json(
            {
                "machine": msgspec.to_builtins(compared.machine),
                "other_python": options.against,
                "other_machine": msgspec.to_builtins(compared.other_machine),
                "pairs": [pair.as_json for pair in compared.pairs],
                "unpaired": compared.unpaired,
            }
        )
    else:
        output().print(pairs_table(compared.pairs).as_rich())
        print_line(f"this: {machine_line(compared.machine)}")
        print_line(f"other ({options.against}): {machine_line(compared.other_machine)}")
        for pair in compared.pairs:
            if not pair.same_work:
                print_line(f"measured with different settings: {pair.name}")
        for name in compared.unpaired:
            print_line(f"not in all runs: {name}")
    return DONE


def _timed_titles() -> Callable[[str], None]:
    """A function that prints the title of a measurement and the seconds since this call."""
    started = time.monotonic()

    def say_title(title: str) -> None:
        say(f"{time.monotonic() - started:4.0f} s  {title}")

    return say_title
