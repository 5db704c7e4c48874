"""Change the code a little, again and again: each time a test must fail.

    python -m benchmarks.mutation_run [--only PART]

Needs the extra `mutation` (cosmic-ray, which makes the changes) beside `test`. What is changed is
`stacking.py` and all that a reward is computed by. A copy of the sources is changed, never these.
Prints the survivors and a row for each part; exit code 1 where one survives that `EQUIVALENT` does
not explain.
"""

import argparse
import multiprocessing
import os
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.ast.ast_query import ASTQuery
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("src", "tests", "pyproject.toml")

SLOW = ("same_clearances", "physical", "cap_of_the_lateral")
"""Flights of the lateral task, which show no more of a change than the small cases do."""


class Part(NamedTuple):
    """What is changed, and who should notice."""

    module: str
    functions: tuple[str, ...]
    """The whole module where none is given."""
    tests: tuple[str, ...]


CYCLE_TESTS = ("tests/tasks/test_cycle_rewards.py",)
PARTS = {
    "stacking": Part(
        "stacking.py", (), ("tests/test_stacking.py", "-k", f"not ({' or '.join(SLOW)})")
    ),
    "rewards": Part("tasks/rewards.py", (), ("tests/tasks/test_rewards.py", *CYCLE_TESTS)),
    "cycle": Part(
        "tasks/navigation.py",
        ("judge", "_running_reward", "_safety", "_criteria"),
        CYCLE_TESTS,
    ),
    "pairs": Part(
        "tasks/pairs.py",
        ("Pairs", "pairs_of", "closest_nm", "distance_nm"),
        ("tests/tasks/test_pairs.py::test_predicted_closest_approach", *CYCLE_TESTS),
    ),
}

ARITHMETIC, BITS = "Add|Sub|Mul|Div|FloorDiv|Mod|Pow", "BitAnd|BitOr|BitXor|LShift|RShift"
POINTLESS = re.compile(
    rf"Binary\w+_({ARITHMETIC})_({BITS}|FloorDiv|Mod|Pow)|Binary\w+_({BITS})_({ARITHMETIC}|.Shift)"
    r"|Comparison\w+_Is(Not)?$"
)
"""Operators that end in a type error here (bits of floats, sums of truth values, identity), or say
no more than another one does."""

EQUIVALENT = {
    "useful = allowed(told, given.wanted & (count != most))": (
        "instructions are counted one by one from 0"
    ),
    "if limit is None and issued.instructions == ENDLESS:": "without a limit ENDLESS is the limit",
    "memory = memory._replace(strayed=memory.strayed ^ (ended[None] & ~memory.entered))": (
        "who has strayed had entered"
    ),
    "return jnp.min(jnp.where(pairs.active, each, 1.0), axis=0, initial=0.0)": (
        "the least is taken of 0 too"
    ),
}
"""Changed lines that mean the same as before, and why."""

IMPORTED = ["tests.conftest", "skystack.simulator.generator", "optax", "pyarrow", "scipy.stats"]
"""Once, for the processes of all tests: nothing of it imports what is changed."""
CONTEXT = multiprocessing.get_context("forkserver")


class Mutant(NamedTuple):
    source: str
    line: int
    before: str
    after: str


def mutants(source: str, functions: Sequence[str]) -> Iterator[Mutant]:
    """Every change of one operator at one place."""
    lines = source.splitlines()
    for name in operator_names():
        operator = get_operator(name)
        if operator.arguments() or POINTLESS.search(name):
            continue
        places = (
            (node, start)
            for node in ast_nodes(get_ast(source))
            for start, _ in operator().mutation_positions(node)
        )
        for number, (node, (line, _)) in enumerate(places):
            if not functions or ASTQuery(node).get_definition_name() in functions:
                changed = mutate_code(source, operator(), number)
                after = changed.splitlines()[line - 1]
                yield Mutant(changed, line, lines[line - 1].strip(), after.strip())


def _test(tests: Sequence[str]) -> None:
    """In a process of its own: exit code 0 where all tests pass."""
    sys.path[:0] = [str(Path.cwd()), str(Path("src").absolute())]
    sys.dont_write_bytecode = True  # it would be taken for that of the next change
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    quiet = ("-W", "ignore::pytest.PytestAssertRewriteWarning")  # plugins are imported before
    sys.exit(pytest.main(["-x", "-n0", "-p", "no:cacheprovider", *quiet, *tests]))


def outcome(tests: Sequence[str], limit_s: float) -> str:
    """survived, killed or timed out."""
    process = CONTEXT.Process(target=_test, args=(tests,))
    process.start()
    process.join(limit_s)
    if process.is_alive():
        process.kill()
        process.join()
        return "timed out"
    return "killed" if process.exitcode else "survived"


def say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def run_part(part: Part) -> Counter[str]:
    """Try all mutants of a part in a copy of the project; survivors are printed."""
    path, counts = Path("src", "skystack", part.module), Counter[str]()
    source, began = path.read_text(), time.monotonic()
    if outcome(part.tests, 600.0) != "survived":
        sys.exit(f"mutation_run: the tests of {part.module} fail without a change")
    limit_s = 10.0 + 5.0 * (time.monotonic() - began)
    for mutant in mutants(source, part.functions):
        path.write_text(mutant.source)
        end = outcome(part.tests, limit_s)
        if end == "survived":
            end = "equivalent" if mutant.after in EQUIVALENT else end
            say(f"{end}: {part.module}:{mutant.line}: {mutant.before} -> {mutant.after}")
        counts[end] += 1
    path.write_text(source)
    return counts


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", choices=PARTS, help="one part")
    only = parser.parse_args(arguments).only
    os.environ["XLA_FLAGS"] = "--xla_backend_optimization_level=0"  # what is computed is little
    CONTEXT.set_forkserver_preload(IMPORTED)
    survived = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in COPIED:
            copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
            copy(ROOT / name, Path(folder) / name)
        os.chdir(folder)
        os.environ["PYTHONPATH"] = "src"
        for name in [only] if only else PARTS:
            began = time.monotonic()
            counts = run_part(PARTS[name])
            ends = ", ".join(f"{count} {end}" for end, count in sorted(counts.items()))
            seconds = time.monotonic() - began
            say(f"{name}: {counts.total()} mutants: {ends}; {seconds:.0f} s")
            survived += counts["survived"]
    return 1 if survived else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
