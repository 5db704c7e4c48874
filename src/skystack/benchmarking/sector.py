"""The speed of sector control: the traffic, training, and the decisions of the shipped policy.

An aircraft-step is one radar cycle of one flight, or its outlook in one cycle. Free slots do not
count.
"""

import statistics
import time
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from skystack.benchmarking.figures import Figure, rates
from skystack.compilation.programs import compile_for_cores
from skystack.evaluation.controllers import find_controller
from skystack.evaluation.hours import HourFlyer
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.learning import ppo
from skystack.learning.experiment import load_experiment
from skystack.learning.parts import compile_update, cores_for, prepare_process
from skystack.learning.seeds import training_key
from skystack.simulator.arrival_flows import Flow, constant_rate
from skystack.tasks.contract import ManyAgents
from skystack.tasks.registry import build_task, build_training_task
from skystack.tasks.sector_control import ACTIONS, ControlState, SectorControl
from skystack.tasks.sector_world import World, WorldState

EXPERIMENT = "sector-control"
RATE, SLOTS = 250.0, 128
"""Flights per hour, with which about 60 flights are in the sector."""
WARM_UP, CYCLES = 300, 16
"""The cycles flown untimed while the sector fills, and the cycles per timed call."""
SCENARIOS = 16
FIRST_UPDATES = 60
"""The updates of training that are not timed, in which the sector fills."""
FLIGHTS, DECISIONS = (50, 70), 40
"""The number of flights with which decisions are timed, and the decisions per repetition."""


def sector_figures(repetitions: int) -> list[Figure]:
    """The figures of traffic, outlooks, sector control and decisions."""
    compile_for_cores(1)
    return [
        *traffic_figures(repetitions),
        *decision_figures(WARM_UP + DECISIONS * repetitions),
    ]


def traffic_figures(repetitions: int) -> list[Figure]:
    """Aircraft-steps per second of the traffic alone, of outlooks alone, and of sector control.

    Sector control includes the traffic, the outlooks, the rewards and the observations.
    """
    task = build_task(load_experiment(EXPERIMENT).task)
    assert isinstance(task, SectorControl)
    task = SectorControl(
        Flow(task.simulator, constant_rate(RATE), slots=SLOTS), task.cycles, task.reward
    )
    start, flights = _filled(task.world)
    setup = (
        f"{RATE:g} flights per hour on {SLOTS} slots, {flights / SCENARIOS / CYCLES:.0f} flights "
        f"on average, {SCENARIOS} scenarios at once, one process"
    )
    present = int(np.sum(start.traffic.active))
    timed: list[tuple[str, Any, Any, int]] = [
        ("sector traffic", jax.jit(partial(_fly, task.world)), start, flights),
        ("sector outlook", jax.jit(task.world.look_ahead), start, present),
        ("sector control, observed", jax.jit(partial(_control, task)), task.begin(start), flights),
    ]
    return [
        Figure(name, "aircraft-steps/s", _rates(run, state, steps, repetitions), setup)
        for name, run, state, steps in timed
    ]


def _rates(run: Any, state: Any, steps: int, repetitions: int) -> tuple[float, ...]:
    return rates(lambda: jax.device_get(run(state)), steps, repetitions)


def _filled(world: World) -> tuple[WorldState, int]:
    """States after `WARM_UP` cycles, and the number of aircraft-steps of the next `CYCLES`."""

    def cycle(state: WorldState, _: None) -> tuple[WorldState, Any]:
        return world.advance(state)[0], jnp.sum(state.traffic.active)

    @partial(jax.jit, static_argnums=1)
    def flown(state: WorldState, cycles: int) -> tuple[WorldState, Any]:
        return jax.lax.scan(cycle, state, length=cycles)

    reset = jax.jit(jax.vmap(world.reset, out_axes=-1))
    start, _ = flown(reset(jax.random.split(jax.random.key(0), SCENARIOS)), WARM_UP)
    return start, int(np.sum(flown(start, CYCLES)[1]))


def _fly(world: World, state: WorldState) -> Any:
    def cycle(state: WorldState, _: None) -> tuple[WorldState, Any]:
        state, flown = world.advance(state)
        return state, flown.exited_correctly

    return jax.lax.scan(cycle, state, length=CYCLES)


def _control(task: SectorControl, state: ControlState) -> Any:
    """Random actions for one flight in ten, as in training."""
    act_key, action_key = jax.random.split(jax.random.key(1))
    shape = (CYCLES, *state.burst.shape)
    acts = jax.random.uniform(act_key, shape) < 0.1
    actions = jnp.where(acts, jax.random.randint(action_key, shape, 0, len(ACTIONS)), 0)

    def step(state: ControlState, action: Any) -> tuple[ControlState, Any]:
        state, outcome = task.advance(task.told(state, action))
        return state, (outcome.reward, jnp.sum(task.observe(state), axis=0))

    return jax.lax.scan(step, state, actions)


def sector_training_figures(repetitions: int) -> list[Figure]:
    """Samples per second of training: the decisions of single flights. Call this in a new process.

    Their mean number is estimated from the flights that decide after an update. Flights that wait
    while another one is instructed, with time frozen, contribute no samples.
    """
    chosen = load_experiment(EXPERIMENT)
    settings, task = chosen.ppo, build_training_task(chosen.task)
    assert isinstance(task, ManyAgents)
    prepare_process(task)
    learner = jax.jit(partial(ppo.init, task, settings))(training_key(0))
    update: Any = compile_update(task, settings, learner)
    count: Any = jax.jit(lambda scenarios: jnp.sum(task.active(scenarios)))
    deciding, elapsed_s = [], []
    for number in range(FIRST_UPDATES + repetitions):
        started = time.perf_counter()
        learner, measured = update(learner)
        jax.device_get(measured)
        if number >= FIRST_UPDATES:
            elapsed_s.append(time.perf_counter() - started)
            deciding.append(int(count(learner.scenarios)))
    samples = settings.steps * statistics.mean(deciding)
    speeds = tuple(samples / each for each in elapsed_s)
    setup = (
        f"settings of `{EXPERIMENT}`: {settings.environments} environments, {settings.steps} steps,"
        f" {settings.epochs} epochs, minibatches of {settings.minibatch}; after {FIRST_UPDATES} "
        f"updates; one process with {cores_for(task)} threads"
    )
    return [Figure(f"training, {EXPERIMENT}", "samples/s", speeds, setup)]


def decision_figures(cycles: int) -> list[Figure]:
    """The time that the shipped policy takes for all transmissions of a cycle."""
    conditions = TrafficConditions(f"{RATE:g}", cycles=cycles)
    found = find_controller(EXPERIMENT, conditions)
    hour = HourFlyer(found.world, cycles, found.per_cycle).fly(found.agent, 0, 0)
    flights = np.sum(hour.traffic.active, axis=1)
    fewest, most = FLIGHTS
    times_ms = hour.decision_ms[(flights >= fewest) & (flights <= most)]
    if not len(times_ms):
        return []
    setup = (
        f"policy `{EXPERIMENT}`, {fewest} to {most} flights, up to {found.per_cycle} transmissions "
        "in a cycle"
    )
    return [Figure("decision for a sector", "ms", tuple(times_ms.tolist()), setup)]
