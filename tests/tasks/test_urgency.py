"""Which other flights matter most, against a comparison pair by pair."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.simulator.traffic import ticks
from skystack.tasks.outlook import look_ahead
from skystack.tasks.prediction import TIMES_S, path_as_cleared
from skystack.tasks.urgency import FAR, NEIGHBOURS
from tests.tasks.sector_traffic import SIMULATOR, SLOTS, after

SECTOR = SIMULATOR.sector


def urgency_of(world):
    """The urgency of each flight for each flight of one scenario, as the module defines it."""
    traffic = world.traffic
    path = path_as_cleared(SECTOR, traffic)
    at = np.stack([path.east_nm, path.north_nm], axis=-1)[::2].astype(float)
    scale = np.asarray(SECTOR.plane.scale(traffic.position_nm[:, 1]))
    levels = np.stack([traffic.level_ticks, traffic.cleared_level_ticks]).astype(float)
    exit_level = np.asarray(world.plan.exit_level_ticks, dtype=float)
    active = np.flatnonzero(traffic.active)
    found = np.full((SLOTS, SLOTS), FAR)
    for own in active:
        low = min(*levels[:, own], exit_level[own]) - float(ticks(20.0))
        high = max(*levels[:, own], exit_level[own]) + float(ticks(20.0))
        for other in active[active != own]:
            apart = max(levels[:, other].min() - high, low - levels[:, other].max(), 0.0)
            distance_nm = np.hypot(*(at[:, other] - at[:, own]).T) / scale[own]
            late_nm = np.array(TIMES_S[::2]) / 60.0
            found[own, other] = (distance_nm + late_nm).min() + apart / float(ticks(5.0))
    return found


@pytest.mark.slow
def test_the_most_urgent_others_are_those_that_come_closest_at_the_levels_used():
    """For a batch of two scenarios with different flights."""
    worlds = [after(120, seed).world for seed in (0, 1)]
    two = jax.tree.map(lambda *values: jnp.stack(values, axis=-1), *worlds)
    progress = two.progress
    outlook = look_ahead(
        SIMULATOR, two.traffic, progress.next_fix, two.plan.exit_level_ticks, progress.entered
    )
    for number, world in enumerate(worlds):
        expected = urgency_of(world)
        nearest_first = np.argsort(expected, axis=1, kind="stable")[:, :NEIGHBOURS]
        active = np.asarray(world.traffic.active)
        urgency = np.asarray(outlook.urgency)[..., number]
        sorted_urgency = np.take_along_axis(expected, nearest_first, axis=1).T
        np.testing.assert_allclose(urgency[:, active], sorted_urgency[:, active], rtol=1e-5)
        exists = (urgency < FAR)[:, active]
        assert exists.any()
        slots = np.asarray(outlook.neighbour)[..., number][:, active]
        np.testing.assert_array_equal(slots[exists], nearest_first.T[:, active][exists])
