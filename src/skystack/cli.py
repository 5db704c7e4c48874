"""The command line: `skystack <verb>`. Thin: parses, calls, prints.

Results go to standard output, progress and prose to standard error. Exit code 0: done; 1: failed
while running; 2: wrong usage or input, told in one line. Heavy imports wait until they are needed.
"""

import argparse
import difflib
import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import skystack
from skystack.errors import InputError, PlatformError, TrainingError

DONE, FAILED, WRONG, INTERRUPTED = 0, 1, 2, 130


class _Parser(argparse.ArgumentParser):
    """An argument parser that complains in one line, with the nearest option."""

    def error(self, message: str) -> NoReturn:
        message = " ".join(message.split())
        if message.startswith("unrecognized arguments: "):
            word = message.split()[2].split("=")[0]
            near = difflib.get_close_matches(word, self._option_string_actions, n=1)
            message += f" (did you mean {near[0]}?)" if near else f" (see {self.prog} --help)"
        verb = self.prog.partition(" ")[2]
        raise InputError(f"{verb}: {message}" if verb else message)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    # Terminated like interrupted: workers are stopped and checkpoints written on the way out.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        options = _parse(list(sys.argv[1:] if arguments is None else arguments))
        run: Callable[[argparse.Namespace], int] = options.run
        return run(options)
    except InputError as error:
        return _complain(str(error), WRONG)
    except (TrainingError, PlatformError) as error:
        return _complain(str(error), FAILED)
    except BrokenPipeError:
        return FAILED
    except KeyboardInterrupt:
        return _complain("interrupted", INTERRUPTED)


def _complain(message: str, code: int) -> int:
    sys.stderr.write(f"skystack: {message}\n")
    return code


def _parse(arguments: list[str]) -> argparse.Namespace:
    parser = _build_parser()
    verbs = _verbs(parser)
    # argparse would list all verbs but name no near one.
    verb = next((word for word in arguments if not word.startswith("-")), None)
    if verb is not None and verb not in verbs:
        near = difflib.get_close_matches(verb, verbs, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"unknown verb {verb!r}{hint} (allowed: {', '.join(verbs)})")
    options, unknown = parser.parse_known_args(arguments)
    if unknown:
        verbs[options.verb].error(f"unrecognized arguments: {' '.join(unknown)}")
    return options


def _verbs(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def _build_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="skystack",
        description="Online action-stacking for air traffic control.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"skystack {skystack.__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")

    def verb(name: str, does: str, run: Callable[[argparse.Namespace], int]) -> _Parser:
        sub: _Parser = verbs.add_parser(name, help=does, description=does, allow_abbrev=False)
        sub.set_defaults(run=run)
        sub.add_argument("--json", action="store_true", help="print one JSON object")
        return sub

    def platform(sub: _Parser) -> None:
        sub.add_argument(
            "--platform",
            default="skystack",
            metavar="NAME",
            help="the simulator to fly in: skystack (default), bluebird, bluesky (extras)",
        )
        sub.add_argument(
            "--time-limit",
            type=_positive,
            default=120,
            metavar="S",
            help="seconds for one scenario in another simulator (default 120)",
        )

    verb("list", "experiments, tasks, sectors, shipped policies", _list)

    sub = verb("reproduce", "train, evaluate, compare with the paper, write the report", _reproduce)
    _reproduce_arguments(sub)

    sub = verb("train", "train a policy", _train)
    sub.add_argument("experiment", metavar="EXPERIMENT", help="a name (see list) or a .toml file")
    sub.add_argument("--seed", type=_seed, default=0, help="default 0")
    sub.add_argument("--out", type=Path, metavar="DIR", help="default runs/EXPERIMENT-sSEED")
    sub.add_argument("--resume", action="store_true", help="go on from the folder's checkpoint")
    sub.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="changes",
        help="change a setting, as ppo.total_steps=500000; may be repeated",
    )

    sub.add_argument(
        "--tensorboard",
        action="store_true",
        help="write the curves for TensorBoard too (extra), into the folder",
    )

    sub = verb("evaluate", "judge a policy on held-out scenarios", _evaluate)
    sub.add_argument("policy", metavar="POLICY", help="a shipped policy's name or a run folder")
    sub.add_argument("--episodes", type=_positive, default=1000, help="default 1000")
    sub.add_argument("--seed", type=_seed, default=0, help="of the scenarios, default 0")
    sub.add_argument(
        "--stacking",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="compile bursts into single clearances (default) or not",
    )
    how = sub.add_mutually_exclusive_group()
    how.add_argument("--greedy", action="store_true", help="the most probable action (default)")
    how.add_argument("--sample", action="store_true", help="an action drawn by its probability")
    sub.add_argument(
        "--out", type=Path, metavar="DIR", help="where a folder of tables (Parquet) is made"
    )
    platform(sub)

    sub = verb("report", "write the report of a run again, or compare several runs", _report)
    sub.add_argument(
        "runs", nargs="+", type=Path, metavar="RUN", help="a folder of reproduce or of train"
    )
    sub.add_argument(
        "-o",
        dest="output",
        type=Path,
        metavar="FILE.html",
        help="the page of a comparison (default comparison.html)",
    )

    sub = verb("simulate", "fly a scenario file", _simulate)
    sub.add_argument("scenario", type=Path, metavar="SCENARIO.json")
    sub.add_argument("-o", dest="output", type=Path, metavar="FILE", help="trajectories (Parquet)")
    platform(sub)

    sub = verb("export", "write a flown scenario or a policy for another program", _export)
    sub.add_argument(
        "source",
        metavar="SOURCE",
        help="scn: a scenario file, or the folder of an evaluation; else: a policy, as in evaluate",
    )
    sub.add_argument(
        "--format",
        choices=["scn", "onnx", "numpy"],
        default="scn",
        help="scn: a scenario for BlueSky (default); onnx (extra), numpy: a policy",
    )
    sub.add_argument("--scenario", type=_seed, metavar="N", help="which of the folder, default 0")
    sub.add_argument("-o", dest="output", type=Path, required=True, metavar="FILE")

    sub = verb("bench", "measure how fast it is here", _bench)
    sub.add_argument("--peers", action="store_true", help="and what others are, where installed")
    sub.add_argument("--quick", action="store_true", help="few things, once: to see that it works")
    return parser


def _reproduce_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "families",
        nargs="*",
        metavar="FAMILY",
        help="lateral, vertical, avoidance, all (default: lateral --quick)",
    )
    sub.add_argument("--seeds", type=_positive, default=1, help="training seeds (default 1)")
    sub.add_argument("--episodes", type=_positive, help="scenarios to judge on (default 1000)")
    sub.add_argument("--out", type=Path, metavar="DIR", help="folder for everything written")
    sub.add_argument("--quick", action="store_true", help="a short training, to see it work")
    sub.add_argument(
        "--platform",
        action="append",
        default=[],
        metavar="NAME",
        dest="platforms",
        help="fly the policies in another simulator too: bluebird, bluesky; may be repeated",
    )
    sub.add_argument(
        "--engine",
        choices=["processes", "ray"],
        default="processes",
        help="where it trains: processes, one a core (default); ray, on a cluster (extra)",
    )
    sub.add_argument(
        "--ray-address",
        metavar="HOST:PORT",
        help="the cluster (default: what RAY_ADDRESS names, or this machine's)",
    )


def _integer(text: str, least: int) -> int:
    try:
        number = int(text)
    except ValueError:
        number = least - 1
    if not least <= number < 2**31:
        raise argparse.ArgumentTypeError(f"{text!r} (allowed: whole numbers from {least})")
    return number


def _positive(text: str) -> int:
    return _integer(text, least=1)


def _seed(text: str) -> int:
    return _integer(text, least=0)


def _print_json(value: Any) -> None:
    sys.stdout.write(json.dumps(value, indent=1) + "\n")


def _list(options: argparse.Namespace) -> int:
    from skystack.catalogue import catalogue, catalogue_table
    from skystack.console import output

    found = catalogue()
    if options.json:
        _print_json(found)
    else:
        for table in catalogue_table(found):
            output().print(table)
    return DONE


def _reproduce(options: argparse.Namespace) -> int:
    from skystack.console import count_scenarios, prose, show_progress
    from skystack.platforms.registry import said_of
    from skystack.programs import compile_for_one_core, kept_programs
    from skystack.reporting.report import write_report
    from skystack.reproduction.plan import QUICK_EPISODES, plan_families
    from skystack.reproduction.run import run_plan, run_platforms

    engine = _engine(options)
    quick = options.quick or not options.families
    families = options.families or ["lateral"]
    default = Path("runs") / ("-".join(families) + ("-quick" if quick else ""))
    out = options.out or default
    episodes = options.episodes or (QUICK_EPISODES if quick else 1000)
    words = ["skystack", "reproduce", *families]
    words += ["--seeds", str(options.seeds), "--episodes", str(episodes)]
    words += ["--engine ray"] * (options.engine == "ray")
    words += ["--quick"] * quick + [f"--platform {name}" for name in options.platforms]
    command = " ".join(words)
    seeds, platforms = options.seeds, options.platforms
    plan = plan_families(families, seeds, episodes, out, quick, command, platforms)
    compile_for_one_core()
    with kept_programs(), show_progress() as report:
        results = run_plan(plan, report, engine)
    if results["kept"]:
        prose().print(f"{len(results['kept'])} finished pieces kept from an earlier run")
    prose().print("writing figures and report ...")
    path = write_report(out)
    failed: list[str] = []
    if plan.platforms:
        for line in (line for name in plan.platforms for line in said_of(name)):
            prose().print(line, soft_wrap=True, highlight=False)
        failed = run_platforms(plan, results, count_scenarios)
        write_report(out)
    _show_results(results, options.json)
    prose().print(f"{results['wall_s']:.0f} s; report: {path}", highlight=False, soft_wrap=True)
    for line in failed:
        _complain(line, FAILED)
    return FAILED if failed else DONE


def _show_results(results: Mapping[str, Any], as_json: bool) -> None:
    """The contents of a `results.json`."""
    from skystack.console import output
    from skystack.reporting.tables import comparison_of, platforms_of

    elsewhere = results.get("platforms", [])
    if as_json:
        shown = ["rows", "rows_by_seed", "comparisons", "train", "wall_s"]
        shown += ["platforms"] * bool(elsewhere)
        _print_json({key: results[key] for key in shown if key in results})
    else:
        output().print(comparison_of(results["rows"]).as_rich())
        if elsewhere:
            output().print(platforms_of(elsewhere).as_rich())


def _engine(options: argparse.Namespace) -> Any:
    from skystack.reproduction.cluster import run_on_cluster
    from skystack.reproduction.processes import run_in_processes

    if options.engine == "ray":
        return partial(run_on_cluster, address=options.ray_address)
    if options.ray_address:
        raise InputError("reproduce: --ray-address is for --engine ray")
    return run_in_processes


def _train(options: argparse.Namespace) -> int:
    from skystack.console import prose, show_progress
    from skystack.learning.event_files import event_files
    from skystack.learning.experiment import load_experiment
    from skystack.learning.run import Progress, train_experiment
    from skystack.programs import compile_for_one_core, kept_programs

    experiment = load_experiment(options.experiment, options.changes)
    name = f"{experiment.name}-s{options.seed}"
    out = options.out or Path("runs") / name
    compile_for_one_core()
    events = event_files(out) if options.tensorboard else nullcontext(lambda: None)
    try:
        with kept_programs(), events as follow, show_progress() as report:

            def on_update(step: Progress) -> None:
                report(name, step)
                follow()

            trained = train_experiment(experiment, options.seed, out, options.resume, on_update)
    except KeyboardInterrupt:
        return _complain(
            f"interrupted; to go on: skystack train {options.experiment} --seed {options.seed} "
            f"--out {out} --resume"
            + " --tensorboard" * options.tensorboard
            + "".join(f" --set {change}" for change in options.changes),
            INTERRUPTED,
        )
    prose().print(f"{trained.wall_s:.0f} s; policy: {out / 'policy.json'}", soft_wrap=True)
    if options.json:
        summary = [trained.summary]
        _print_json({"rows": [], "rows_by_seed": [], "train": summary, "wall_s": trained.wall_s})
    return DONE


def _evaluate(options: argparse.Namespace) -> int:
    from skystack.catalogue import find_policy
    from skystack.console import count_scenarios, output, prose
    from skystack.evaluation.judge import Conditions, judge
    from skystack.evaluation.summary import aggregate
    from skystack.platforms.registry import said_of
    from skystack.programs import compile_for_one_core, kept_programs
    from skystack.reporting.tables import comparison_of

    begun = time.monotonic()
    conditions = Conditions(
        seed=options.seed,
        episodes=options.episodes,
        stacking=options.stacking,
        greedy=not options.sample,
        platform=options.platform,
        time_limit_s=options.time_limit,
    )
    policy = find_policy(options.policy)
    compile_for_one_core()
    counting = count_scenarios(options.platform, options.episodes)
    with kept_programs(), counting as on_scenario:
        judged = judge(policy, conditions, options.out, on_scenario)
    for line in said_of(options.platform):
        prose().print(line, soft_wrap=True, highlight=False)
    rows = [aggregate([judged.row], [judged.episodes])]
    if options.json:
        wall_s = time.monotonic() - begun
        result = {"rows": rows, "rows_by_seed": [judged.row], "train": [], "wall_s": wall_s}
        _print_json(result | ({"failed": judged.failed} if judged.failed else {}))
    else:
        output().print(comparison_of(rows).as_rich())
    for number, why in judged.failed.items():
        _complain(f"{options.platform}: scenario {number} {why}", FAILED)
    return FAILED if judged.failed else DONE


def _report(options: argparse.Namespace) -> int:
    from skystack.console import prose
    from skystack.reporting.report import write_report
    from skystack.reporting.trainings import is_reproduction

    first, *others = options.runs
    if others or not is_reproduction(first):
        return _compare(options)
    if options.output:
        raise InputError(f"report: -o is for comparisons; the report of {first} lies in it")
    path = write_report(first)
    _show_results(json.loads((first / "results.json").read_bytes()), options.json)
    prose().print(f"report: {path}", highlight=False, soft_wrap=True)
    return DONE


def _compare(options: argparse.Namespace) -> int:
    from skystack.console import output, prose
    from skystack.reporting.comparison import comparison_json, comparison_tables, write_comparison
    from skystack.reporting.trainings import read_runs

    path = options.output or Path("comparison.html")
    runs = read_runs(options.runs)
    write_comparison(runs, path)
    if options.json:
        _print_json(comparison_json(runs))
    else:
        for table in comparison_tables(runs):
            output().print(table.as_rich())
    prose().print(f"comparison: {path}", highlight=False, soft_wrap=True)
    return DONE


def _simulate(options: argparse.Namespace) -> int:
    from skystack.console import output, prose
    from skystack.simulate import simulate_file, summary_table

    summary = simulate_file(options.scenario, options.output, options.platform, options.time_limit)
    for line in summary["notes"]:
        prose().print(line, soft_wrap=True, highlight=False)
    if options.json:
        _print_json(summary)
    else:
        output().print(summary_table(summary))
    return DONE


def _export(options: argparse.Namespace) -> int:
    from skystack.console import prose
    from skystack.export.formats import export

    for line in export(options.source, options.format, options.scenario, options.output):
        prose().print(line, soft_wrap=True, highlight=False)
    if options.json:
        _print_json({"source": options.source, "output": str(options.output)})
    return DONE


def _bench(options: argparse.Namespace) -> int:
    from skystack.benchmarking.run import QUICK, Effort, machine, measure_ourselves
    from skystack.benchmarking.shown import figures_table, machine_line, number
    from skystack.console import output, prose

    begun = time.monotonic()

    def told(what: str) -> None:
        prose().print(f"{time.monotonic() - begun:4.0f} s  {what}", highlight=False)

    effort = QUICK if options.quick else Effort()
    figures = measure_ourselves(effort, told)
    missing: dict[str, str] = {}
    faster: dict[str, float] = {}
    if options.peers:
        from skystack.benchmarking.peers import measure_peers, ratios

        found, missing = measure_peers(effort, told)
        figures += found
        faster = ratios(figures)
    if options.json:
        shown = [figure.as_json for figure in figures]
        _print_json(
            {
                "machine": machine(),
                "figures": shown,
                "ratios": faster,
                "not_measured": missing,
            }
        )
    else:
        output().print(figures_table(figures).as_rich())
        output().print(machine_line(machine()), highlight=False, soft_wrap=True)
        for name, times in faster.items():
            output().print(f"{number(times)} times as fast as {name}", highlight=False)
        for name, why in missing.items():
            output().print(f"not measured: {name}: {why}", highlight=False, soft_wrap=True)
    return DONE
