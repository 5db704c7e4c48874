"""The verbs and their arguments. Errors are one line, with the nearest valid word."""

import argparse
import difflib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import skystack
from skystack.benchmarking.groups import GROUPS
from skystack.cli import verbs
from skystack.cli.flight_school import flight_school, flight_school_arguments
from skystack.cli.hours import controller_arguments
from skystack.cli.reproduce import reproduce
from skystack.cli.session import session, session_arguments
from skystack.cli.values import cycles_argument, natural, platform_argument, positive
from skystack.errors import InputError
from skystack.io.streams import StandardOutput


class Parser(argparse.ArgumentParser):
    """An argument parser that reports errors in one line, with the nearest option."""

    def error(self, message: str) -> NoReturn:
        message = " ".join(message.split())
        if message.startswith("unrecognized arguments: "):
            word = message.split()[2].split("=")[0]
            options = set(re.findall(r"--?[a-z][a-z-]*", self.format_help()))
            near = difflib.get_close_matches(word, sorted(options), n=1, cutoff=0.7)
            message += f" (did you mean {near[0]}?)" if near else f" (see {self.prog} --help)"
        verb = self.prog.partition(" ")[2]
        raise InputError(f"{verb}: {message}" if verb else message)

    def print_help(self, file: Any = None) -> None:
        """Print help to standard output; argparse itself ignores write errors."""
        StandardOutput().write(self.format_help())


class _HelpFormatter(argparse.HelpFormatter):
    """Leaves room for the longest verb; argparse does not count the indentation of verbs."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog)
        self._action_max_length = len("    reproduce")


class _Version(argparse.Action):
    """Print the version to standard output; argparse itself ignores write errors."""

    def __call__(self, parser: argparse.ArgumentParser, *values: Any, **named: Any) -> NoReturn:
        StandardOutput().write(f"skystack {skystack.__version__}\n")
        parser.exit()


class Commands(NamedTuple):
    """The parser of the command line, and those of its verbs."""

    parser: argparse.ArgumentParser
    verbs: dict[str, argparse.ArgumentParser]


def parse(arguments: list[str]) -> argparse.Namespace:
    """The options of a command line; `options.run` is the verb's function. Raises InputError."""
    parser, known = build_parser()
    if not arguments:
        arguments = ["--help"]
    # argparse would list all verbs but not suggest the nearest one.
    verb = next((word for word in arguments if not word.startswith("-")), None)
    if verb is not None and verb not in known:
        near = difflib.get_close_matches(verb, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"unknown verb {verb!r}{hint} (allowed: {', '.join(known)})")
    options, unknown = parser.parse_known_args(arguments)
    if unknown:
        known[options.verb].error(f"unrecognized arguments: {' '.join(unknown)}")
    return options


def build_parser() -> Commands:
    """The parser of the command line with all verbs and arguments."""
    parser = Parser(
        prog="skystack",
        description="Online action-stacking for air traffic control.",
        epilog="`skystack VERB --help` describes the arguments of a verb.",
        allow_abbrev=False,
        formatter_class=_HelpFormatter,
    )
    version = "show the version and exit"
    parser.add_argument("--version", action=_Version, nargs=0, help=version)
    subparsers = parser.add_subparsers(title="verbs", dest="verb", required=True, metavar="VERB")
    parsers: dict[str, argparse.ArgumentParser] = {}

    def verb(name: str, does: str, run: Callable[[argparse.Namespace], int]) -> Parser:
        sentence = f"{does[0].upper()}{does[1:]}."
        sub: Parser = subparsers.add_parser(
            name, help=does, description=sentence, allow_abbrev=False
        )
        sub.set_defaults(run=run)
        sub.add_argument("--json", action="store_true", help="print one JSON object")
        parsers[name] = sub
        return sub

    def platform(sub: Parser) -> None:
        platform_argument(sub)
        sub.add_argument(
            "--time-limit",
            type=positive,
            default=120,
            metavar="S",
            help="limit for a scenario in another simulator, in seconds of real time (default 120)",
        )

    verb("list", "list experiments, tasks, sectors, policies and other names", verbs.list_all)

    sub = verb(
        "reproduce",
        "train, evaluate, compare with the paper and write a report",
        reproduce,
    )
    _reproduce_arguments(sub)

    sub = verb("train", "train a policy", verbs.train)
    _train_arguments(sub)

    sub = verb("evaluate", "evaluate a policy on held-out scenarios", verbs.evaluate)
    _evaluate_arguments(sub)
    platform(sub)

    sub = verb(
        "flight-school",
        "fly a controller on Flight School traffic: an hour per seed, in parallel",
        flight_school,
    )
    flight_school_arguments(sub)

    sub = verb("session", "control live traffic on a radar page or in a terminal", session)
    session_arguments(sub)

    sub = verb("report", "write the report of a run again, or compare several runs", verbs.report)
    sub.add_argument(
        "runs",
        nargs="+",
        type=Path,
        metavar="RUN",
        help="a run folder of train, reproduce, flight-school or evaluate --traffic",
    )
    sub.add_argument(
        "-o",
        dest="output",
        type=Path,
        metavar="FILE.html",
        help="page of the comparison (default comparison.html)",
    )

    sub = verb("sector", "check, describe and draw a sector", verbs.sector)
    sub.add_argument("sector", metavar="SECTOR", help="a name (see list) or a sector file (.json)")
    sub.add_argument(
        "-o", dest="output", type=Path, metavar="FILE", help="write a map: .png or .svg"
    )
    cycles_argument(sub, "300", 300)

    sub = verb("replay", "replay flights on a radar display: page, picture or film", verbs.replay)
    _replay_arguments(sub)

    sub = verb("simulate", "fly a scenario file", verbs.simulate)
    sub.add_argument("scenario", type=Path, metavar="SCENARIO.json", help="a scenario file")
    sub.add_argument(
        "-o", dest="output", type=Path, metavar="FILE", help="write the trajectories (Parquet)"
    )
    platform(sub)

    sub = verb("export", "export a flown scenario or a policy for another program", verbs.export)
    sub.add_argument(
        "source",
        metavar="SOURCE",
        help="scn: a scenario file or the folder of an evaluation; onnx, numpy: a policy",
    )
    sub.add_argument(
        "--format",
        choices=["scn", "onnx", "numpy"],
        default="scn",
        help="scn: a scenario for BlueSky (default); onnx (extra), numpy: a policy",
    )
    sub.add_argument(
        "--scenario",
        type=natural,
        metavar="N",
        help="scn: the scenario of the evaluation (default 0)",
    )
    sub.add_argument(
        "-o", dest="output", type=Path, required=True, metavar="FILE", help="the file to write"
    )

    sub = verb("bench", "measure the speed on this machine", verbs.bench)
    sub.add_argument(
        "--peers", action="store_true", help="also measure other programs that are installed"
    )
    sub.add_argument(
        "--quick", action="store_true", help="measure only a few figures, once, as a check"
    )
    sub.add_argument(
        "--only",
        nargs="+",
        choices=GROUPS,
        metavar="GROUP",
        help=f"measure only the named groups, out of: {', '.join(GROUPS)}",
    )
    sub.add_argument(
        "--against",
        metavar="PYTHON",
        help="compare with the skystack installed for the interpreter PYTHON, in turn",
    )
    return Commands(parser, parsers)


def _reproduce_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "families",
        nargs="*",
        metavar="FAMILY",
        help="lateral, vertical, avoidance or all (default: lateral and lateral-best)",
    )
    sub.add_argument(
        "--seeds",
        type=positive,
        default=1,
        metavar="N",
        help="training seeds per experiment (default 1)",
    )
    sub.add_argument(
        "--episodes",
        "--scenarios",
        type=positive,
        metavar="N",
        help="scenarios per evaluation (default 1000, with --quick 200)",
    )
    sub.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="run folder (default runs/FAMILY, without a family runs/first-look)",
    )
    sub.add_argument("--quick", action="store_true", help="short training runs, as a check")
    sub.add_argument(
        "--platform",
        action="append",
        default=[],
        metavar="NAME",
        dest="platforms",
        help="also fly in another simulator: bluebird, bluesky; may be repeated",
    )
    sub.add_argument(
        "--engine",
        choices=["processes", "ray"],
        default="processes",
        help="run in processes, one per core (default), or on a Ray cluster (extra)",
    )
    sub.add_argument(
        "--ray-address",
        metavar="HOST:PORT",
        help="address of the cluster (default: $RAY_ADDRESS, else this machine's)",
    )


def _train_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("experiment", metavar="EXPERIMENT", help="a name (see list) or a .toml file")
    sub.add_argument(
        "--seed", type=natural, default=0, metavar="N", help="training seed (default 0)"
    )
    sub.add_argument(
        "--out", type=Path, metavar="DIR", help="run folder (default runs/EXPERIMENT-sSEED)"
    )
    sub.add_argument(
        "--resume", action="store_true", help="continue from the checkpoint in the run folder"
    )
    sub.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="changes",
        help="change a setting, such as ppo.total_steps=500000; may be repeated",
    )
    cycles_argument(sub)
    sub.add_argument(
        "--checkpoint-every",
        type=natural,
        default=60,
        metavar="S",
        help="seconds between checkpoints (default 60; 0: after every update)",
    )
    sub.add_argument(
        "--tensorboard",
        action="store_true",
        help="also write event files for TensorBoard into the run folder (extra)",
    )


def _evaluate_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "policy",
        metavar="POLICY",
        help="a shipped policy, a run folder, or a file: .onnx, .zip (Stable-Baselines3); with "
        "--traffic also an agent of sector control: no-op, own-navigation, "
        "own-navigation-exit-level, rules, search or mvp, or your own module:Class",
    )
    sub.add_argument(
        "--traffic",
        metavar="TRAFFIC",
        help="sector control: fly hours of arriving traffic: a number of flights per hour; "
        "category, notebook or environment (BluebirdDT's Flight School); springfield:SCENARIO; or, "
        "without arrivals, an experiment (name or .toml) or a scenario file (.json)",
    )
    controller_arguments(sub, "with --traffic: ")
    sub.add_argument(
        "--experiment",
        metavar="NAME",
        help="for a file: the experiment it was trained for, a name or a .toml file",
    )
    sub.add_argument(
        "--episodes",
        "--scenarios",
        type=positive,
        metavar="N",
        help="number of scenarios (default 1000), or of hours with --traffic (default 1)",
    )
    sub.add_argument(
        "--seed", type=natural, default=0, metavar="N", help="seed of the scenarios (default 0)"
    )
    sub.add_argument(
        "--stacking",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="compile bursts into single clearances (default: yes)",
    )
    how = sub.add_mutually_exclusive_group()
    how.add_argument(
        "--greedy", action="store_true", help="take the most probable action (default)"
    )
    how.add_argument(
        "--sample", action="store_true", help="sample actions from the policy's probabilities"
    )
    sub.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="write the tables (Parquet) into a new folder in DIR",
    )
    sub.add_argument(
        "--sector", metavar="NAME", help="another sector: a name (see list) or a file (.json)"
    )
    cycles_argument(sub)


def _replay_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "recorded",
        type=Path,
        metavar="FLIGHTS",
        help="the folder of an evaluation, or the .parquet file of simulate",
    )
    sub.add_argument(
        "other",
        type=Path,
        nargs="?",
        metavar="OTHER",
        help="other flights of the same scenarios or traffic",
    )
    sub.add_argument(
        "-o",
        dest="output",
        type=Path,
        default=Path("replay.html"),
        metavar="FILE",
        help="page .html (default replay.html), picture .png or .svg, film .gif or .mp4",
    )
    sub.add_argument(
        "--scenarios",
        type=positive,
        metavar="N",
        help="page: the first N scenarios (default 100; for hours of traffic: 5)",
    )
    sub.add_argument(
        "--scenario", type=natural, metavar="N", help="picture, film: the scenario (default 0)"
    )
    for word, default in (("from", "the start"), ("to", "the end")):
        sub.add_argument(
            f"--{word}",
            dest=f"{word}_s",
            type=natural,
            metavar="S",
            help=f"picture, film: {word} this second (default: {default})",
        )
