"""Fleets: several aircraft types in one scenario."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binomtest, chisquare

from skystack.airspace.sectors import sector_named
from skystack.errors import InputError
from skystack.learning.experiment import load_experiment
from skystack.simulator.fleet import AircraftType, fleet
from skystack.simulator.generator import LateralScenarios
from skystack.simulator.performance import TICKS_PER_FL, Performance, TablePerformance
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import start
from skystack.tasks.registry import build_task

SLOW = AircraftType(
    type="AT76", share=3.0, low_cas_kt=(160.0, 170.0, 180.0), high_cas_kt=(160.0, 170.0, 180.0),
    mach=(0.4, 0.44, 0.42), rate_ft_min=1200.0, ceiling_fl=250.0,
)  # fmt: skip
MIXED = fleet((AircraftType(), SLOW))


def array(*values):
    return jnp.asarray(values, dtype=jnp.float32)


def test_a_fleet_is_a_performance_model():
    assert isinstance(MIXED, Performance)
    assert MIXED.types == ("B753", "AT76")


@pytest.mark.parametrize("phase", [1.0, 0.0, -1.0])
def test_each_type_flies_by_its_own_table(phase):
    levels = array(0.0, 120.0, 240.0, 300.0, 400.0) * TICKS_PER_FL
    phases = jnp.full_like(levels, phase)
    tables = [TablePerformance(), SLOW.table()]
    for kind, table in enumerate(tables):
        kinds = jnp.full(levels.shape, kind, dtype=jnp.int32)
        for name in ("true_airspeed_kt", "vertical_speed_ft_min"):
            mixed = getattr(MIXED, name)(levels, phases, kinds)
            assert np.array_equal(mixed, getattr(table, name)(levels, phases))


def test_types_fly_at_their_own_airspeeds_side_by_side():
    """At these levels the airspeed is the Mach number times the speed of sound, 573.6 kt."""
    simulator = Simulator(sector_named("x-plus"), MIXED)
    level = array(370.0, 370.0) * TICKS_PER_FL
    kind = jnp.array([0, 1], dtype=jnp.int32)
    traffic = start(
        position_nm=jnp.zeros((2, 2)),
        heading_deg=array(90.0, 90.0),
        level_ticks=level,
        route=jnp.zeros(2, dtype=jnp.int32),
        ground_speed_kt=simulator.level_ground_speed_kt(level, kind),
        own_navigation=jnp.zeros(2, dtype=bool),
        kind=kind,
    )
    fly = jax.jit(simulator.advance)
    for _ in range(100):  # ten minutes
        traffic = fly(traffic)
    sound_kt = np.sqrt(1.4 * 287.05287 * 216.65) * 3600.0 / 1852.0
    expected = np.array([0.80, 0.44]) * sound_kt / 6.0
    assert traffic.position_nm[:, 0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_draws_types_by_share_and_levels_uniformly():
    simulator = Simulator(sector_named("x-plus"), MIXED)
    drawn = LateralScenarios(simulator, levels_fl=(280, 300, 340), shares=(1.0, 3.0))
    keys = jax.random.split(jax.random.key(3), 2000)
    traffic = jax.vmap(drawn.draw)(keys).traffic
    slow = int(np.sum(traffic.kind))
    assert binomtest(slow, 4000, 0.75).pvalue > 1e-3
    found, counts = np.unique(traffic.level_ticks / TICKS_PER_FL, return_counts=True)
    assert found.tolist() == [280.0, 300.0, 340.0]
    assert chisquare(counts).pvalue > 1e-3
    # Independently: every pair of levels and every pair of types occurs.
    assert len({tuple(row) for row in np.asarray(traffic.level_ticks)}) == 9
    assert len({tuple(row) for row in np.asarray(traffic.kind)}) == 4
    # Positions and routes are those drawn without types and levels.
    alone = jax.vmap(LateralScenarios(Simulator(simulator.sector, TablePerformance())).draw)(keys)
    assert np.array_equal(traffic.position_nm, alone.traffic.position_nm)
    assert np.array_equal(traffic.route, alone.traffic.route)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (['task.fleet=[{type="A320"},{type="A320"}]'], "task.fleet[1].type is A320 (allowed:"),
        (['task.fleet=[{type="A320"}]', "task.performance=constant"], "task.performance is con"),
        (['task.fleet=[{type="a-320"}]'], 'task.fleet[0].type is "a-320" (allowed: text of 2 to'),
        (['task.fleet=[{type="A320\\n"}]'], 'task.fleet[0].type is "A320\\n" (allowed: text of 2'),
        (["task.fleet=[{share=0}]"], "task.fleet[0].share is 0 (allowed: number above 0, up to 1,"),
        (
            ["task.fleet=[{mach=[0.8,0.8]}]"],
            "task.fleet[0].mach is [0.8, 0.8] (allowed: list of 3)",
        ),
        (["task.fleet=[{speed=3}]"], "task.fleet[0]: unknown field 'speed' (allowed: cei"),
        (["task.level_fl=[300,305]"], "task.level_fl is 305 (allowed in x-plus: multiples"),
        (["task.level_fl=[]"], "task.level_fl is [] (allowed: whole number or list of 1 to 61)"),
    ],
)
def test_refuses_an_invalid_fleet_in_one_line(changes, message):
    with pytest.raises(InputError) as error:
        load_experiment("lateral", changes)
    assert str(error.value).startswith(f"--set: {message}")


def test_settings_determine_types_and_levels():
    changes = ['task.fleet=[{type="A320"},{type="AT76", rate_ft_min=1200, share=2}]']
    task = build_task(load_experiment("lateral", [*changes, "task.level_fl=[280,300]"]).task)
    assert task.simulator.performance.types == ("A320", "AT76")
    assert task.scenarios.shares == (1.0, 2.0)
    assert task.scenarios.levels_fl == (280, 300)
