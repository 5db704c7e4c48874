"""Scenarios flown through the platform protocol: the same results as ours, and failures."""

from functools import partial

import numpy as np
import pytest

pytest.importorskip("pebble")

from skystack.errors import PlatformError
from skystack.evaluation.agreement import same_clearances
from skystack.evaluation.evaluate import Conditions, evaluate, policy_task
from skystack.evaluation.platform_rollout import PlatformRollout, fly_on_platform
from skystack.evaluation.rollout import NO_OP_CONTROLLER, concatenate, fly, network_controller
from skystack.evaluation.tables import make_tables
from skystack.policies.shipped import find_policy
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings
from tests.waiting import TIMEOUT_S

from .faulty import (
    BREAKS,
    DIES,
    LEAVES,
    LOSES,
    NONSENSE,
    open_and_die,
    open_badly,
    open_faulty,
    open_nothing,
    open_own,
)


def no_op():
    return NO_OP_CONTROLLER


SHORT = build_task(NavigationSettings(cycles=12))


@pytest.mark.slow
def test_our_simulator_flies_the_same_through_the_protocol(tmp_path):
    """In another loop, in other processes: the same clearances, cycles and metrics."""
    policy = find_policy("lateral-tuned")
    task = policy_task(policy)
    controller = partial(network_controller, policy.actor, policy.normaliser, True)
    job = PlatformRollout(task, controller, True, 0, open_own)
    finished = []
    failed = {}
    elsewhere = concatenate(
        list(fly_on_platform(job, 8, tmp_path, failed, on_scenario=finished.append))
    )
    here = fly(task, controller(), 0, 8, True)
    assert (failed, finished) == ({}, list(range(1, 9)))
    ours, theirs = make_tables(task, here), make_tables(task, elsewhere)
    assert all(same_clearances(ours.clearances, theirs.clearances, range(8), cycles=0))
    assert ours.episodes["success"].equals(theirs.episodes["success"])
    assert ours.episodes["cycles"].equals(theirs.episodes["cycles"])
    for name in ("min_separation_nm", "return"):
        np.testing.assert_allclose(ours.episodes[name], theirs.episodes[name], rtol=1e-3)
    assert ours.trajectories.num_rows == theirs.trajectories.num_rows
    for name in ("lat", "lon"):
        np.testing.assert_allclose(ours.trajectories[name], theirs.trajectories[name], atol=1e-5)


@pytest.mark.slow
def test_reports_failed_scenarios_and_finishes_the_others(tmp_path):
    failed = {}
    flown = concatenate(
        list(fly_on_platform(faulty(9), 9, tmp_path, failed, time_limit_s=TIMEOUT_S))
    )
    assert flown.number.tolist() == [0, 2, 3, 8]
    assert failed == {
        DIES: "the simulator's process died (exit code 7)",
        LOSES: "Faulty has lost AC1",
        BREAKS: "failed: KeyError: 'AC1'",
        NONSENSE: "reported a lat of AC1 that is not finite",
        LEAVES: "failed: SystemExit: 0",
    }
    numbers = make_tables(SHORT, flown).episodes["scenario"]
    assert numbers.to_pylist() == [0, 2, 3, 8]


@pytest.mark.slow
def test_abandons_a_simulator_that_hangs(tmp_path):
    """All scenarios hang: a healthy one might exceed a short time limit on a busy machine."""
    with pytest.raises(PlatformError, match="no scenario was finished: scenario 0 took more than"):
        list(fly_on_platform(faulty(2, hangs=(0, 1)), 2, tmp_path, {}, time_limit_s=1.0))


def faulty(scenarios, hangs=()):
    starts = tuple(start[0] for start in starting_latitudes(scenarios))
    return PlatformRollout(SHORT, no_op, False, 0, partial(open_faulty, starts, hangs))


def starting_latitudes(count):
    here = fly(SHORT, NO_OP_CONTROLLER, 0, count, False).start
    plane = SHORT.simulator.sector.plane
    return plane.to_degrees(np.asarray(here.position_nm, dtype=np.float64))[..., 0].round(6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("opener", "message"),
    [
        (open_nothing, "it does not start"),
        (open_badly, "did not start: ImportError: no such library"),
        (open_and_die, "its process died, or took too long, while starting"),
    ],
)
def test_a_platform_that_does_not_start_is_an_error(tmp_path, opener, message):
    with pytest.raises(PlatformError, match=f"no scenario was finished: scenario 0 {message}"):
        list(fly_on_platform(PlatformRollout(SHORT, no_op, False, 0, opener), 2, tmp_path, {}))


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["bluebird", "bluesky"])
def test_other_simulators_give_the_same_tables(platform, tmp_path):
    pytest.importorskip({"bluebird": "bluebird_dt", "bluesky": "bluesky"}[platform])
    policy, episodes = find_policy("lateral-tuned"), 4
    ours = evaluate(policy, Conditions(episodes=episodes), tmp_path)
    theirs = evaluate(policy, Conditions(episodes=episodes, platform=platform), tmp_path)
    assert theirs.row["platform"] == platform
    assert theirs.row.keys() == ours.row.keys()
    assert theirs.row["success_rate"] == 1.0
    assert theirs.episodes.schema == ours.episodes.schema
    assert theirs.clearances.schema == ours.clearances.schema
    folders = sorted(path.name for path in tmp_path.iterdir())
    assert folders == [
        f"lateral-tuned-s0-{name}-stacked" for name in sorted([platform, "skystack"])
    ]
    if platform == "bluebird":
        assert all(same_clearances(ours.clearances, theirs.clearances, range(episodes)))


@pytest.mark.slow
def test_vertical_control_is_the_same_in_bluebird(tmp_path):
    """Own navigation and level clearances, through the same protocol."""
    pytest.importorskip("bluebird_dt")
    policy = find_policy("vertical")
    ours = evaluate(policy, Conditions(episodes=4), None)
    theirs = evaluate(policy, Conditions(episodes=4, platform="bluebird"), None)
    assert all(same_clearances(ours.clearances, theirs.clearances, range(4)))
    assert theirs.row["success_rate"] == ours.row["success_rate"] == 1.0
    assert theirs.clearances["text"].equals(ours.clearances["text"])
