"""Hand-made recordings: no scenario is flown, so every value in a table is known."""

import numpy as np

from skystack.evaluation.rollout import Recording
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import Traffic
from skystack.tasks.contract import AircraftStatus

NOT_IN_TABLES = {"next_fix": 1, "turn_radius_nm": 0.0, "pending_turn": 0, "turn_deg": 0.0}


def traffic(shape, **columns):
    """Traffic of a shape, in the units of the tables; by default level at FL300, heading 0."""
    defaults = {
        "position_nm": np.zeros((*shape, 2)),
        "heading_deg": 0.0,
        "level_ticks": 300.0,
        "ground_speed_kt": 400.0,
        "vertical_speed_ft_min": 0.0,
        "cleared_heading_deg": 0.0,
        "cleared_level_ticks": 300.0,
        "own_navigation": False,
        "route": 0,
        "kind": 0,
        "active": True,
    }
    given = defaults | NOT_IN_TABLES | columns
    for name in ("level_ticks", "cleared_level_ticks"):
        given[name] = np.asarray(given[name], dtype=float) * TICKS_PER_FL
    given["flown_heading_deg"] = given["cleared_heading_deg"]
    given["flown_level_ticks"] = given["cleared_level_ticks"]
    return Traffic(**{name: _filled(name, value, shape) for name, value in given.items()})


def _filled(name, value, shape):
    full_shape = (*shape, 2) if name == "position_nm" else shape
    array = np.array(np.broadcast_to(value, full_shape))
    return array.astype(np.float32) if array.dtype == float else array


def recording(number, ran, aircraft=2, *, start=None, later=None, **fields):
    """`ran` is `[scenarios, cycles]`; `start` and `later` are columns of the traffic."""
    ran = np.asarray(ran, dtype=bool)
    scenarios, cycles = ran.shape
    never = np.zeros((scenarios, cycles, aircraft), dtype=bool)
    defaults = {
        "exit_level_ticks": np.full((scenarios, aircraft), 300.0 * TICKS_PER_FL, dtype=np.float32),
        "start_status": AircraftStatus(*[np.zeros((scenarios, aircraft), dtype=bool)] * 3),
        "status": AircraftStatus(entered=never, exited=never, excursion=never),
        "action": np.zeros(ran.shape, dtype=np.int32),
        "instructions": np.zeros(ran.shape, dtype=np.int32),
        "reward": np.zeros(ran.shape, dtype=np.float32),
        "metrics": metrics(scenarios),
    }
    return Recording(
        number=np.array(number, dtype=np.int32),
        start=traffic((scenarios, aircraft), **(start or {})),
        traffic=traffic((scenarios, cycles, aircraft), **(later or {})),
        ran=ran,
        **defaults | fields,
    )


def metrics(scenarios, **given):
    """Metrics at the end of each scenario; by default all are successful."""
    defaults = {
        "success": True,
        "correct_exit": True,
        "excursion": False,
        "few_instructions": True,
        "instructions": 0.0,
        "bursts": 0.0,
        "min_separation_nm": np.inf,
        "cycles": 1.0,
    }
    return {
        name: np.full(scenarios, given.get(name, value), dtype=np.asarray(value).dtype)
        for name, value in defaults.items()
    }
