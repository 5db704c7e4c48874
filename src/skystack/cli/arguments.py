"""The verbs and their arguments; mistakes are told in one line, with the nearest word."""

import argparse
import difflib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import skystack
from skystack.cli import verbs
from skystack.errors import MOST_NUMBER, InputError
from skystack.io.streams import StandardOutput


class _Parser(argparse.ArgumentParser):
    """An argument parser that complains in one line, with the nearest option."""

    def error(self, message: str) -> NoReturn:
        message = " ".join(message.split())
        if message.startswith("unrecognized arguments: "):
            word = message.split()[2].split("=")[0]
            near = difflib.get_close_matches(word, self._option_string_actions, n=1, cutoff=0.7)
            message += f" (did you mean {near[0]}?)" if near else f" (see {self.prog} --help)"
        verb = self.prog.partition(" ")[2]
        raise InputError(f"{verb}: {message}" if verb else message)

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print help and version; argparse itself ignores write errors."""
        StandardOutput().write(message)


def parse(arguments: list[str]) -> argparse.Namespace:
    """The options of a command line; `run` is what does it. Raises InputError for a wrong one."""
    parser = build_parser()
    known = verbs_of(parser)
    # argparse would list all verbs but name no near one.
    verb = next((word for word in arguments if not word.startswith("-")), None)
    if verb is not None and verb not in known:
        near = difflib.get_close_matches(verb, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"unknown verb {verb!r}{hint} (allowed: {', '.join(known)})")
    options, unknown = parser.parse_known_args(arguments)
    if unknown:
        known[options.verb].error(f"unrecognized arguments: {' '.join(unknown)}")
    return options


def verbs_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The parser of each verb."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def build_parser() -> argparse.ArgumentParser:
    """All verbs with all their arguments."""
    parser = _Parser(
        prog="skystack",
        description="Online action-stacking for air traffic control.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"skystack {skystack.__version__}")
    subparsers = parser.add_subparsers(dest="verb", required=True, metavar="VERB")

    def verb(name: str, does: str, run: Callable[[argparse.Namespace], int]) -> _Parser:
        sub: _Parser = subparsers.add_parser(name, help=does, description=does, allow_abbrev=False)
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

    verb("list", "experiments, tasks, sectors, shipped policies", verbs.list_all)

    sub = verb(
        "reproduce", "train, evaluate, compare with the paper, write the report", verbs.reproduce
    )
    _reproduce_arguments(sub)

    sub = verb("train", "train a policy", verbs.train)
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
    _cycles(sub)
    sub.add_argument(
        "--checkpoint-every",
        type=_seed,
        default=60,
        metavar="S",
        help="seconds between checkpoints (default 60; 0: after every update)",
    )
    sub.add_argument(
        "--tensorboard",
        action="store_true",
        help="write the curves for TensorBoard too (extra), into the folder",
    )

    sub = verb("evaluate", "judge a policy on held-out scenarios", verbs.evaluate)
    _evaluate_arguments(sub)
    platform(sub)

    sub = verb("report", "write the report of a run again, or compare several runs", verbs.report)
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

    sub = verb("sector", "check a sector, describe and draw it", verbs.sector)
    sub.add_argument("sector", metavar="SECTOR", help="a name (see list) or a sector file (.json)")
    sub.add_argument("-o", dest="output", type=Path, metavar="FILE", help="a map: .png or .svg")
    _cycles(sub, "300", 300)

    sub = verb("replay", "write a page that replays what was flown, as on a radar", verbs.replay)
    _replay_arguments(sub)

    sub = verb("simulate", "fly a scenario file", verbs.simulate)
    sub.add_argument("scenario", type=Path, metavar="SCENARIO.json")
    sub.add_argument("-o", dest="output", type=Path, metavar="FILE", help="trajectories (Parquet)")
    platform(sub)

    sub = verb("export", "write a flown scenario or a policy for another program", verbs.export)
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

    sub = verb("bench", "measure how fast it is here", verbs.bench)
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


def _evaluate_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "policy",
        metavar="POLICY",
        help="a shipped policy's name, a run folder, or a file: .onnx, .zip (Stable-Baselines3)",
    )
    sub.add_argument(
        "--experiment",
        metavar="NAME",
        help="what a file is for: an experiment (see list) or its .toml file",
    )
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
    sub.add_argument(
        "--sector", metavar="NAME", help="another sector (see list) or a sector file (.json)"
    )
    _cycles(sub)


def _cycles(
    sub: argparse.ArgumentParser, default: str = "the experiment's", value: int | None = None
) -> None:
    sub.add_argument(
        "--cycles",
        type=_most_cycles,
        default=value,
        metavar="N",
        help=f"the most cycles of a scenario, in place of task.cycles (default: {default})",
    )


def _replay_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "recorded",
        type=Path,
        metavar="RUN",
        help="the folder of an evaluation, or trajectories of simulate (.parquet)",
    )
    sub.add_argument(
        "other", type=Path, nargs="?", metavar="OTHER", help="another of the same scenarios"
    )
    sub.add_argument(
        "-o",
        dest="output",
        type=Path,
        default=Path("replay.html"),
        metavar="FILE",
        help="a page, .html (default replay.html), or a picture: .png, .svg, or a film: .gif",
    )
    sub.add_argument(
        "--scenarios",
        type=_positive,
        metavar="N",
        help="page: the first N (default 100)",
    )
    sub.add_argument("--scenario", type=_seed, metavar="N", help="picture: which (default 0)")
    for word, default in (("from", "the start"), ("to", "the end")):
        sub.add_argument(
            f"--{word}",
            dest=f"{word}_s",
            type=_seed,
            metavar="S",
            help=f"picture: seconds into the scenario (default {default})",
        )


def _integer(text: str, least: int, most: int = MOST_NUMBER) -> int:
    try:
        number = int(text)
    except ValueError:
        number = least - 1
    if not least <= number <= most:
        limit = f" to {most}" if most < MOST_NUMBER else ""
        raise argparse.ArgumentTypeError(f"{text!r} (allowed: whole numbers from {least}{limit})")
    return number


def _most_cycles(text: str) -> int:
    return _integer(text, least=1, most=10_000)


def _positive(text: str) -> int:
    return _integer(text, least=1)


def _seed(text: str) -> int:
    return _integer(text, least=0)
