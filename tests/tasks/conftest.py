"""The lateral task, and traffic at chosen positions for it."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest

from skystack.simulator.traffic import Traffic, start, ticks
from skystack.tasks.navigation import NavigationTask
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

STRAIGHT = ("HERON", "CRANE", "EGL", "MACAW", "QUAIL", "SWIFT")
REVERSED = STRAIGHT[::-1]
TURNING = ("HERON", "CRANE", "EGL", "FINCH", "ROBIN")

Builder = Callable[..., Traffic]


@pytest.fixture(scope="session")
def task() -> NavigationTask:
    return build_task(NavigationSettings())


@pytest.fixture(scope="session")
def traffic_on(task: NavigationTask) -> Builder:
    """A function that places aircraft on routes, by default at their first fixes."""

    def build(*routes, positions=None, headings=None, fl=300.0) -> Traffic:
        sector = task.simulator.sector
        if positions is None:
            positions = [sector.fixes_nm[route[0]] for route in routes]
        if headings is None:
            headings = [sector.first_heading_deg(route) for route in routes]
        level = jnp.full(len(routes), ticks(fl), dtype=jnp.float32)
        return start(
            position_nm=jnp.asarray(np.array(positions), dtype=jnp.float32),
            heading_deg=jnp.asarray(headings, dtype=jnp.float32),
            level_ticks=level,
            route=jnp.asarray([sector.routes.index(route) for route in routes], dtype=jnp.int32),
            ground_speed_kt=task.simulator.level_ground_speed_kt(level),
            own_navigation=jnp.zeros(len(routes), dtype=bool),
        )

    return build
