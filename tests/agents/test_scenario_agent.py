"""A policy of the paper's tasks controls a scenario as in an evaluation of its task."""

import numpy as np
import pytest

from skystack.agents.scenario_agent import ScenarioAgent, check_fits_scenario
from skystack.agents.sector_agents import navigation_task_of
from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.evaluation.hours import HourFlyer
from skystack.evaluation.rollout import fly, network_controller
from skystack.evaluation.scenario_traffic import scenario_world
from skystack.policies.shipped import find_policy
from skystack.simulator.performance import TICKS_PER_FL

CYCLES, SEED, SCENARIOS = 70, 1, 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lateral-best", "vertical"])
def test_it_issues_the_clearances_of_an_evaluation(name):
    policy = find_policy(name)
    task = navigation_task_of(policy)
    controller = network_controller(policy.actor, policy.normaliser, greedy=True)
    evaluated = fly(task, controller, SEED, SCENARIOS, stacking=True)
    flyer = HourFlyer(scenario_world(name).world, CYCLES)
    agent = ScenarioAgent(policy, task)
    sent = 0
    for number in range(SCENARIOS):
        hour = flyer.fly(agent, SEED, number)
        flown = evaluated.traffic.position_nm[number, :CYCLES]
        assert evaluated.ran[number, CYCLES - 1]
        np.testing.assert_allclose(
            hour.traffic.position_nm[:, : task.aircraft], flown, atol=1e-4, err_msg=f"{number}"
        )
        np.testing.assert_array_equal(
            hour.traffic.level_ticks[:, : task.aircraft],
            evaluated.traffic.level_ticks[number, :CYCLES],
        )
        counts = evaluated.instructions[number, :CYCLES]
        assert [each.transmission.instructions for each in hour.sent] == counts[counts > 0].tolist()
        sent += len(hour.sent)
    assert sent > 0


@pytest.mark.slow
def test_an_adviser_asked_in_the_middle_of_a_scenario_uses_the_present_state():
    """An adviser is asked afresh, and a person may have issued clearances before."""
    policy = find_policy("vertical")
    flyer = HourFlyer(scenario_world("vertical").world, CYCLES)
    state = flyer.hours.reset(SEED, 0)
    agent = ScenarioAgent(policy, navigation_task_of(policy))
    for _ in range(10):
        state, _ = flyer.hours.advance(state, [])
    agent.begin(state)
    (sent,) = agent.transmit(state)
    exit_fl = float(state.arrivals.exit_level_ticks[0]) / TICKS_PER_FL
    assert sent.level_ticks / TICKS_PER_FL == exit_fl
    assert sent.instructions == abs(exit_fl - state.traffic.level_ticks[0] / TICKS_PER_FL) / 10


def test_refuses_another_number_of_flights_and_another_sector():
    task = navigation_task_of(find_policy("lateral-best"))
    check_fits_scenario(task, x_plus(), 2)
    with pytest.raises(InputError, match=r"a policy for 2 aircraft in a scenario of 3 \(allowed: "):
        check_fits_scenario(task, x_plus(), 3)
    other = scenario_world("examples/own-sector/meeting.json").world.sector
    with pytest.raises(InputError, match=r"sector x-plus in a scenario of \S+ \(allowed: "):
        check_fits_scenario(task, other, 2)
