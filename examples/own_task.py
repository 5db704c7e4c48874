"""A task of your own: keep one aircraft near the middle of the sector, with few turns.

    python examples/own_task.py --steps 600000 --out holding

This trains a policy, evaluates it without and with stacking, and writes a replay and a page with
the learning curve. It needs no change in skystack: the task implements the contract of
`skystack.tasks.contract` and is registered under its name.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import skystack
from skystack.airspace.geometry import bearing, length, wrap_180
from skystack.airspace.sectors import sector_from
from skystack.learning.experiment import Experiment
from skystack.learning.settings import PPOSettings
from skystack.reporting.comparison import write_comparison
from skystack.reporting.replay.page import write_replay
from skystack.reporting.trainings import read_runs
from skystack.simulator.generator import LateralScenarios
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import Traffic
from skystack.tasks.actions import small_turns
from skystack.tasks.contract import AircraftStatus, Metric, Outcome
from skystack.tasks.kinds import Family, TaskKind
from skystack.tasks.registry import register_task
from skystack.tasks.settings import TaskSettings

PRICE = 0.5
"""The cost of every clearance, so that few are issued."""


class HoldingSettings(TaskSettings, frozen=True, forbid_unknown_fields=True):
    """The keys of an experiment's `[task]` table, in addition to name, sector and cycles."""

    radius_nm: float = 15.0
    """How close to the middle the aircraft must be at the end."""


class HoldingState(NamedTuple):
    traffic: Traffic
    cycles: Float[Array, "*batch"]
    instructions: Float[Array, "*batch"]
    instructed: Float[Array, "*batch"]
    """1 if an instruction was issued since the last cycle, otherwise 0."""


@dataclass(frozen=True)
class HoldingTask:
    """Implements `skystack.tasks.contract.TrafficTask` for one aircraft."""

    settings: HoldingSettings
    simulator: Simulator

    name, version, agents, aircraft = "holding", 1, 1, 1
    performance, fleet = "table", ()
    table = small_turns(1)
    action_names, actions = table.names, table.actions
    observation_names = ("turn to the middle", "distance", "turn under way")
    metrics = {  # noqa: RUF012
        "success": Metric("true or false", "near the middle at the end"),
        "correct_exit": Metric("true or false", "same as success: no aircraft should exit"),
        "excursion": Metric("true or false", "always false"),
        "few_instructions": Metric("true or false", "fewer than 30 instructions"),
        "instructions": Metric("count", "instructions so far"),
        "min_separation_nm": Metric("NM", "infinite: there is no other aircraft"),
    }

    @property
    def sector(self):
        return self.simulator.sector

    @property
    def cycles(self):
        return self.settings.cycles

    def reset(self, key):
        traffic, _ = LateralScenarios(self.simulator, aircraft=1).draw(key)
        return HoldingState(traffic, *(jnp.zeros(()) for _ in range(3)))

    def observe(self, state):
        traffic = state.traffic
        turn = wrap_180(bearing(-traffic.position_nm) - traffic.cleared_heading_deg)
        under_way = wrap_180(traffic.cleared_heading_deg - traffic.heading_deg)
        distance_nm = length(traffic.position_nm)
        values = (turn / 360.0 + 0.5, distance_nm / 100.0, under_way / 360.0 + 0.5)
        return jnp.clip(jnp.concatenate(values), 0.0, 1.0)

    def may_stack(self, state, action):
        return self.table.may_stack(state.traffic, action)

    def instruct(self, state, action):
        given = (action != 0).astype(jnp.float32)
        turned = self.table.instruct(state.traffic, action)
        instructed = jnp.maximum(state.instructed, given)
        return HoldingState(turned, state.cycles, state.instructions + given, instructed)

    def advance(self, state):
        return self.end_cycle(state, self.simulator.advance(state.traffic))

    def step(self, state, action):
        return self.advance(self.instruct(state, action))

    def end_cycle(self, state, flown):
        cycles = state.cycles + 1.0
        ended, distance_nm = cycles >= self.cycles, length(flown.position_nm)[0]
        success = distance_nm < self.settings.radius_nm
        reward = -distance_nm / 100.0 - PRICE * state.instructed
        outcome = Outcome(
            reward=(reward + jnp.where(ended & success, 10.0, 0.0))[None],
            terminated=ended[None],
            truncated=jnp.zeros_like(ended)[None],
            ended=ended,
            metrics={
                "success": success,
                "correct_exit": success,
                "excursion": jnp.zeros_like(success),
                "few_instructions": state.instructions < 30.0,
                "instructions": state.instructions,
                "min_separation_nm": jnp.full_like(distance_nm, jnp.inf),
            },
        )
        return HoldingState(flown, cycles, state.instructions, jnp.zeros_like(cycles)), outcome

    def traffic(self, state):
        return state.traffic

    def with_traffic(self, state, traffic):
        return state._replace(traffic=traffic)

    def status(self, state):
        entered = state.traffic.active
        return AircraftStatus(entered, jnp.zeros_like(entered), jnp.zeros_like(entered))

    def exit_level_ticks(self, state):
        return state.traffic.level_ticks

    def succeeded(self, metrics, clearances):
        return np.asarray(metrics["success"])


def build(settings):
    return HoldingTask(settings, Simulator(sector_from(settings.sector), performance("table")))


register_task(
    TaskKind(Family("holding", "Holding"), HoldingSettings, build, "stay near the middle")
)


def experiment(steps):
    return Experiment(
        name="holding-small",
        task=HoldingSettings(name="holding", cycles=150, timing="stack"),
        ppo=PPOSettings(total_steps=steps, learning_rate=1e-3, hidden=(32, 32), gamma=0.995),
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--steps", type=int, default=600_000)
    parser.add_argument("--scenarios", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("holding"))
    options = parser.parse_args()
    run = options.out / "holding-small-s0"
    policy = skystack.train_experiment(experiment(options.steps), 0, run).policy
    for title, stacking in (("one at a time", False), ("stacked", True)):
        conditions = skystack.Conditions(episodes=options.scenarios, stacking=stacking)
        row = skystack.evaluate(policy, conditions, options.out).row
        print(
            f"{title}: {row['clearances_mean']:.1f} clearances per scenario, "
            f"success {row['success_rate']:.0%}"
        )
    write_replay([options.out / "holding-small-s0-skystack-stacked"], options.out / "replay.html")
    write_comparison(read_runs([run]), options.out / "training.html")
