"""The fewest clearances with which turns in 10-degree steps complete the lateral scenarios.

    python -m studies.fewest_clearances [--scenarios 100] [--seed 0] [--exit-nm NM] [--json]
        [-o FILE]

This is a lower bound on the clearances per scenario for controllers that turn in steps of 10
degrees: two aircraft on the evaluation scenarios, flown and scored by the lateral task itself.
Aircraft do not interact in this task, so the minimum is found for each aircraft alone, and that of
a scenario is their sum.

The search over these turns is exhaustive: first no clearance, then every single clearance, then
every pair. A clearance may be issued in every cycle until the aircraft exits or makes an excursion,
to every heading that a stack of 10-degree instructions can reach from the cleared one. Each choice
is flown to its end with the simulator's own turns and its delay of one cycle.

Not searched are headings between those steps, clearances between radar cycles, and turns the longer
way. Exits are detected on the straight chords between radar positions, as in the task. Both
aircraft may be cleared in the same cycle, which a policy with one action per cycle cannot do.
"""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int
from rich.console import Console
from rich.progress import track

from skystack.compilation.fetch import fetched
from skystack.errors import InputError
from skystack.io.files import atomic_write
from skystack.learning.seeds import scenario_key
from skystack.simulator.traffic import Traffic
from skystack.tasks.actions import STEP_DEG, turns
from skystack.tasks.navigation import NavigationState, NavigationTask
from skystack.tasks.navigation_kinds import build_navigation
from skystack.tasks.settings import NavigationSettings

MOST = 2
"""The maximum number of clearances per aircraft that is searched."""
BATCH_CYCLES = 20
"""The number of cycles whose alternatives are flown at once; the first success ends the search."""
TURNS = turns(1, tuple(range(STEP_DEG, 181, STEP_DEG)))
"""Every stack of 10-degree instructions for one aircraft as a single action."""


class Turn(NamedTuple):
    """One heading clearance."""

    cycle: int
    turn_deg: int
    """The change of the cleared heading, positive to the right; a multiple of ten."""


Plan = tuple[Turn, ...]
"""Clearances in the order in which they are issued."""

_compiled = partial(jax.jit, static_argnums=0)


class Search:
    """Searches for the clearances that one aircraft needs in a lateral task."""

    def __init__(self, task: NavigationTask) -> None:
        """Raises ValueError for a task of more than one aircraft."""
        if task.aircraft != 1:
            raise ValueError(f"a task of {task.aircraft} aircraft (allowed: 1)")
        self.task = replace(task, table=TURNS)

    def fewest(self, traffic: Traffic, most: int) -> Plan | None:
        """A plan with the fewest clearances; None if `most` are not enough."""
        state = self.begin(traffic)
        plans = (self.find(state, clearances) for clearances in range(most + 1))
        return next((plan for plan in plans if plan is not None), None)

    def find(self, state: NavigationState, clearances: int) -> Plan | None:
        """The first plan with this number of clearances that succeeds; None if none does."""
        if clearances == 0:
            return () if self.succeeds(state) else None
        path, flying = self.fly(state)
        if clearances == 1:
            return self._find_one(path, int(flying))
        for row in range(int(flying)):
            for action in range(1, len(TURNS.actions)):
                rest = self.find(self.instruct(path, row, action), clearances - 1)
                if rest is not None:
                    return (_turn(path, row, action), *rest)
        return None

    def _find_one(self, path: NavigationState, flying: int) -> Plan | None:
        for first in range(0, flying, BATCH_CYCLES):
            found = np.argwhere(self.one_clearance(path, first))
            if found.size:
                row, turn = found[0].tolist()
                return (_turn(path, first + row, turn + 1),)
        return None

    @_compiled
    def begin(self, traffic: Traffic) -> NavigationState:
        """The state at cycle 0."""
        return self.task.begin(traffic)

    @_compiled
    def succeeds(self, state: NavigationState) -> Bool[Array, ""]:
        """Whether the flight succeeds without further clearances."""
        progress = jax.lax.while_loop(self._in_play, self._advance, state).memory.progress
        return jnp.all(progress.exited_correctly & ~progress.excursion)

    @_compiled
    def fly(self, state: NavigationState) -> tuple[NavigationState, Int[Array, ""]]:
        """The states `[rows]` before every cycle without further clearances, the current one first.

        Also the number of rows in play. There is one row per cycle of the task, rounded up to full
        batches.
        """
        rows = -(-self.task.cycles // BATCH_CYCLES) * BATCH_CYCLES
        _, path = jax.lax.scan(lambda now, _: (self._advance(now), now), state, length=rows)
        return path, jnp.sum(jax.vmap(self._in_play)(path))

    @_compiled
    def instruct(self, path: NavigationState, row: int, action: int) -> NavigationState:
        """One state of a path, instructed with an action of `TURNS`."""
        return self.task.instruct(jax.tree.map(lambda rows: rows[row], path), jnp.asarray(action))

    @_compiled
    def one_clearance(self, path: NavigationState, first: int) -> Bool[Array, "cycles turns"]:
        """Which single clearances succeed, for the batch of states that starts at row `first`.

        Column k is action k + 1 of `TURNS`.
        """

        def by_turn(state: NavigationState) -> Bool[Array, " turns"]:
            instructed = jax.vmap(self.task.instruct, (None, 0))(state, actions)
            succeeds: Array = jax.vmap(self.succeeds)(instructed)
            return self._in_play(state) & succeeds

        actions = jnp.arange(1, len(TURNS.actions))
        batch = jax.tree.map(
            lambda rows: jax.lax.dynamic_slice_in_dim(rows, first, BATCH_CYCLES), path
        )
        return jax.vmap(by_turn)(batch)

    def _in_play(self, state: NavigationState) -> Bool[Array, ""]:
        """Whether success is still possible: before an exit, an excursion and the time limit."""
        flying = jnp.all(state.traffic.active & ~state.memory.progress.excursion)
        return flying & (state.memory.progress.cycles < self.task.cycles)

    def _advance(self, state: NavigationState) -> NavigationState:
        return self.task.advance(state)[0]


def _turn(path: NavigationState, row: int, action: int) -> Turn:
    turn_deg = TURNS.actions[action].change
    return Turn(int(path.memory.progress.cycles[row]), turn_deg)


def draw(task: NavigationTask, seed: int, scenarios: int) -> list[list[Traffic]]:
    """The scenarios of an evaluation seed, each as one traffic per aircraft."""
    keys = jnp.stack([scenario_key(seed, number) for number in range(scenarios)])
    drawn = fetched(jax.jit(jax.vmap(task.scenarios.draw))(keys).traffic)

    def alone(scenario: int, aircraft: int) -> Traffic:
        rows: Traffic = jax.tree.map(lambda x: x[scenario, aircraft : aircraft + 1], drawn)
        return rows

    return [[alone(s, a) for a in range(task.aircraft)] for s in range(scenarios)]


def measure(
    scenarios: int, seed: int, console: Console, exit_nm: float | None = None
) -> dict[str, Any]:
    """The result as written to JSON. Raises RuntimeError if `MOST` clearances are not enough.

    `exit_nm` is half the width of the exits, by default that of the whole edge.
    """
    started = time.perf_counter()
    search = Search(build_navigation(NavigationSettings(aircraft=1, exit_nm=exit_nm)))
    traffic = draw(build_navigation(NavigationSettings(exit_nm=exit_nm)), seed, scenarios)
    fewest = []
    for index, aircraft in enumerate(track(traffic, "searching", console=console)):
        plans = [search.fewest(alone, MOST) for alone in aircraft]
        if None in plans:
            raise RuntimeError(
                f"scenario {index} of seed {seed}: aircraft {plans.index(None) + 1} needs more "
                f"than {MOST} clearances"
            )
        fewest.append(sum(len(plan) for plan in plans if plan is not None))
    return {
        "clearances_mean": float(np.mean(fewest)),
        "per_scenario": fewest,
        "scenarios": scenarios,
        "seed": seed,
        "wall_s": time.perf_counter() - started,
    }


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--scenarios", type=int, default=100, help="number of scenarios (default 100)"
    )
    parser.add_argument("--seed", type=int, default=0, help="evaluation seed (default 0)")
    parser.add_argument("--exit-nm", type=float, help="half the width of the exits (default: all)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("-o", dest="file", type=Path, help="also write the JSON object to a file")
    options = parser.parse_args(arguments)
    if options.scenarios < 1:
        raise InputError(f"--scenarios is {options.scenarios} (allowed: 1 or more)")
    if not 0 <= options.seed < 2**32:
        raise InputError(f"--seed is {options.seed} (allowed: 0 to {2**32 - 1})")
    if options.exit_nm is not None and not 0.1 <= options.exit_nm <= 50.0:
        raise InputError(f"--exit-nm is {options.exit_nm} (allowed: 0.1 to 50)")
    if options.file and not options.file.parent.is_dir():
        raise InputError(f"-o {options.file}: there is no folder {options.file.parent}")
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 0 success, 1 failure, 2 invalid input."""
    console = Console(stderr=True)
    try:
        options = _options(arguments)
        result = measure(options.scenarios, options.seed, console, options.exit_nm)
        text = json.dumps(result) + "\n"
        if options.file:
            atomic_write(options.file, text.encode())
    except (InputError, RuntimeError) as error:
        console.print(f"error: {error}", soft_wrap=True, markup=False, highlight=False)
        return 2 if isinstance(error, InputError) else 1
    prose = (
        f"fewest clearances per scenario: {result['clearances_mean']:.2f} on average of "
        f"{result['scenarios']} (seed {result['seed']}, {result['wall_s']:.0f} s)\n"
    )
    sys.stdout.write(text if options.json else prose)
    return 0


if __name__ == "__main__":
    sys.exit(main())
