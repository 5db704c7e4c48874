"""Trials fly as the flights then do, and their approaches are those of brute force."""

from itertools import combinations

import numpy as np
import pytest

from skystack.agents.probe import Probe
from skystack.agents.transmission import Transmission
from skystack.errors import InputError
from skystack.live.what_if import HORIZON_CYCLES, REPORTED_NM, Planned, WhatIf
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.simulator import CYCLE_S
from skystack.simulator.traffic import ticks

from .made import WORLD, begun_hour, on_frequency

STEPS = 60
"""The points between two cycles of brute force."""
LIMIT_NM, LIMIT_FL = WORLD.sector.loss_below_nm, WORLD.sector.separation_fl


@pytest.fixture(scope="module")
def what_if():
    return WhatIf(Probe(WORLD))


def test_flights_fly_as_predicted_if_nothing_is_issued(what_if):
    hour = begun_hour(seed=4, flights=6)
    ahead = what_if.as_cleared(hour.state).ahead
    known = dict(hour.slots)
    for cycle in range(1, 41):
        hour.advance()
        still = {name: slot for name, slot in known.items() if name in hour.slots}
        assert still
        for slot in still.values():
            assert ahead.present[cycle, slot]
            np.testing.assert_allclose(
                ahead.position_nm[cycle, slot], hour.state.traffic.position_nm[slot], atol=1e-3
            )


def test_a_flight_flies_as_its_trial(what_if):
    hour = begun_hour(seed=5, flights=4)
    slot = hour.slots[on_frequency(hour)[0]]
    heading = (round(float(hour.state.traffic.heading_deg[slot])) + 40) % 360
    level = 200.0 if float(hour.state.traffic.level_ticks[slot]) > ticks(300.0) else 400.0
    first = Transmission(slot, heading_deg=heading, level_ticks=ticks(level))
    later = Transmission(slot, fix=int(hour.state.progress.next_fix[slot]))
    (trial,) = what_if.trials(hour.state, slot, [(Planned(0, first), Planned(9, later))])
    hour.transmit(first)
    for cycle in range(1, 31):
        if cycle == 10:
            hour.transmit(later)
        hour.advance()
        at = hour.state.traffic
        np.testing.assert_allclose(trial.position_nm[cycle], at.position_nm[slot], atol=1e-3)
        assert trial.fl[cycle] == pytest.approx(float(at.level_ticks[slot]) / TICKS_PER_FL)


def test_approaches_are_those_of_brute_force(what_if):
    compared = lost = 0
    for seed in (3, 4, 6):
        state = begun_hour(seed, flights=14).state
        ahead = what_if.as_cleared(state).ahead
        found = {(slot, each.slot): each for slot, each in what_if.closest(state)}
        for pair in combinations(np.flatnonzero(ahead.present[0]).tolist(), 2):
            least_nm, in_s, lost_in_s = brute_force(ahead, *pair)
            if least_nm > REPORTED_NM - 0.05:
                assert pair not in found or found[pair].least_nm > REPORTED_NM - 0.1
                continue
            approach = found[pair]
            compared += 1
            assert approach.least_nm == pytest.approx(least_nm, abs=0.03)
            assert approach.in_s == pytest.approx(in_s, abs=2 * CYCLE_S)
            if abs(least_nm - LIMIT_NM) > 0.05:  # else rounding decides
                assert (approach.lost_in_s is None) == (lost_in_s is None)
            if approach.lost_in_s is not None and lost_in_s is not None:
                assert approach.lost_in_s == pytest.approx(lost_in_s, abs=CYCLE_S)
                lost += 1
    assert compared >= 8
    assert lost >= 2


def brute_force(ahead, one, other):
    """Least distance without vertical separation, its time, and the time of a first loss.

    The flights fly straight between cycles; plane distances are converted at the middle of the two.
    """
    both = ahead.present[:, one] & ahead.present[:, other]
    cycles = int(np.argmin(both)) if not both.all() else len(both)
    times = np.arange(0.0, min(cycles - 1, HORIZON_CYCLES), 1.0 / STEPS)
    row, part = times.astype(int), times % 1.0
    between = [
        values[row] + (values[row + 1] - values[row]) * _like(part, values)
        for values in (ahead.position_nm, ahead.level_ticks)
    ]
    position, level = between[0][:, [one, other]], between[1][:, [one, other]]
    scale = np.asarray(WORLD.sector.plane.scale(position[..., 1].mean(axis=1).astype(np.float32)))
    distance = np.linalg.norm(position[:, 0] - position[:, 1], axis=1) / scale
    close = np.abs(level[:, 0] - level[:, 1]) < ticks(float(LIMIT_FL))
    distance = np.where(close, distance, np.inf)
    if not len(distance) or np.isinf(distance.min()):
        return np.inf, None, None
    lost = distance < LIMIT_NM
    first = float(times[np.argmax(lost)] * CYCLE_S) if lost.any() else None
    return float(distance.min()), float(times[np.argmin(distance)] * CYCLE_S), first


def _like(part, values):
    return part.reshape(-1, *[1] * (values.ndim - 1))


def test_refuses_a_plan_that_is_too_long(what_if):
    hour = begun_hour(flights=1)
    slot = hour.slots[on_frequency(hour)[0]]
    plan = tuple(Planned(wait, Transmission(slot, heading_deg=90)) for wait in range(4))
    with pytest.raises(InputError, match=r"a plan of 4 transmissions \(allowed: at most 3\)"):
        what_if.trials(hour.state, slot, [plan])
