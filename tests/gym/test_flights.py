"""Sector control with one agent per flight: PettingZoo's tests, and the vector environment."""

import warnings

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from skystack.errors import InputError
from skystack.gym.sector import SectorVectorEnvironment
from skystack.tasks.sector_control import TO_FIX
from tests.tasks.sector_traffic import SETTINGS, SLOTS

pettingzoo = pytest.importorskip("pettingzoo")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # its tests import modules that warn
    from pettingzoo.test import parallel_api_test, parallel_seed_test

from skystack.gym.flights import FlightsEnvironment, flights_env  # noqa: E402


@pytest.fixture(scope="module")
def environment():
    return flights_env(settings=SETTINGS)


class Arriving(FlightsEnvironment):
    """Starts once flights have arrived, because PettingZoo's test needs agents at once."""

    def reset(self, seed=None, options=None):
        super().reset(seed, options)
        while not self.agents:
            observations, *_, infos = self.step({})
        return observations, infos


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:No agents present")
def test_passes_the_checks_of_pettingzoo(environment):
    parallel_api_test(Arriving(environment.task, environment.programs), num_cycles=150)


@pytest.mark.slow
def test_equal_seeds_give_identical_episodes(environment):
    both = iter([Arriving(environment.task, environment.programs) for _ in range(2)])
    parallel_seed_test(lambda: next(both), num_cycles=60)


@pytest.mark.slow
def test_it_agrees_with_the_vector_environment(environment):
    """Each flight sees and gets what its slot does, until it has left."""
    slots = SectorVectorEnvironment(environment.task, environment.programs)
    environment.reset(seed=4)
    _, infos = slots.reset(seed=4)
    left = 0
    for _ in range(280):
        slot_of = environment._slots()
        assert set(slot_of) == set(environment.agents)
        np.testing.assert_array_equal(sorted(slot_of.values()), np.flatnonzero(infos["active"]))
        flights = environment.step(dict.fromkeys(environment.agents, TO_FIX))
        seen, rewards, terminated, _truncated, infos = slots.step(np.full(SLOTS, TO_FIX))
        if slots._ended:
            break
        for agent, slot in slot_of.items():
            assert flights[1][agent] == pytest.approx(rewards[slot])
            assert flights[2][agent] == terminated[slot]
            assert not flights[3][agent]
            left += terminated[slot]
            assert (agent in environment.agents) == (not terminated[slot])
            np.testing.assert_array_equal(flights[0][agent], seen[slot])
    assert slots._ended
    assert left > 3
    assert environment.agents == []
    assert {flights[3][agent] for agent in slot_of if not flights[2][agent]} == {True}
    assert all("flights" in info for info in flights[4].values())


@pytest.mark.slow
def test_flights_have_names_of_their_own(environment):
    environment.reset(seed=1)
    names, gone = set(), set()
    for _ in range(90):
        environment.step(dict.fromkeys(environment.agents, TO_FIX))
        assert not gone & set(environment.agents)
        gone |= names - set(environment.agents)
        names |= set(environment.agents)
    assert len(names) > 3
    assert names <= set(environment.possible_agents)


def test_bad_agents_and_actions_are_refused(environment):
    environment.reset(seed=1)
    while not environment.agents:
        environment.step({})
    agent = environment.agents[0]
    with pytest.raises(InputError, match="action is 6"):
        environment.step({agent: 6})
    with pytest.raises(InputError, match="BAW1"):
        environment.step({"BAW1": 0})


def test_a_reset_comes_first(environment):
    with pytest.raises(ResetNeeded):
        FlightsEnvironment(environment.task, environment.programs).step({})
