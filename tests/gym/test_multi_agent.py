"""One agent per aircraft: PettingZoo's own tests, and agreement with the single environment."""

import warnings

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from skystack.errors import InputError
from skystack.gym.registration import make_environment
from skystack.tasks.navigation import NavigationTask
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings, RewardSettings

pettingzoo = pytest.importorskip("pettingzoo")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # its tests import modules that warn
    from pettingzoo.test import parallel_api_test, parallel_seed_test

from skystack.gym.multi_agent import MultiAgentEnvironment, parallel_env  # noqa: E402

SETTINGS = NavigationSettings(name="avoidance", aircraft=2, pair_features=("theta", "d"), cycles=60)
AC1, AC2 = "AC1", "AC2"


@pytest.fixture(scope="module")
def environment():
    return parallel_env(settings=SETTINGS)


@pytest.fixture(scope="module")
def single():
    return make_environment("avoidance", SETTINGS)


@pytest.mark.slow
def test_passes_the_checks_of_pettingzoo(environment):
    parallel_api_test(environment, num_cycles=100)


def test_equal_seeds_give_identical_episodes(environment):
    other = MultiAgentEnvironment(environment.task, programs=environment.programs)
    both = iter((environment, other))
    parallel_seed_test(lambda: next(both), num_cycles=30)


def test_one_acting_agent_agrees_with_the_single_environment(environment, single):
    """AC1's observation, rewards, ends and metrics. In the table, AC2's actions follow AC1's."""
    seen, _ = environment.reset(seed=4)
    expected, _ = single.reset(seed=4)
    assert np.array_equal(environment.state(), expected)
    rng, ended = np.random.default_rng(0), False
    while not ended:
        agent, action = str(rng.choice([AC1, AC2])), int(rng.integers(3))
        index = action + 2 if agent == AC2 and action else action
        expected, reward, ended, _, info = single.step(index)
        seen, rewards, terminated, truncated, infos = environment.step({agent: action})
        np.testing.assert_allclose(seen[AC1], expected, atol=1e-5)
        assert rewards == {AC1: pytest.approx(reward, abs=1e-5), AC2: rewards[AC1]}
        assert terminated == {AC1: ended, AC2: ended}
        assert truncated == {AC1: False, AC2: False}
    assert infos == {AC1: pytest.approx(info, abs=1e-3), AC2: infos[AC1]}
    assert environment.agents == []


def test_every_agent_observes_itself_first(environment):
    """The four values of each aircraft are exchanged; the distance between the two is the same."""
    environment.reset(seed=4)
    seen, *_ = environment.step({AC1: 1, AC2: 2})
    first, second = seen[AC1], seen[AC2]
    assert np.array_equal(first[:4], second[4:8])
    assert np.array_equal(first[4:8], second[:4])
    assert first[9] == pytest.approx(second[9], abs=1e-6)
    turns = [360.0 * value - 180.0 for value in (first[8], second[8])]
    headings = environment.task_state.traffic.cleared_heading_deg
    # The bearings between the two aircraft are opposite.
    assert (turns[0] + headings[0] - turns[1] - headings[1]) % 360.0 == pytest.approx(180, abs=0.1)


THREE = NavigationSettings(
    aircraft=3,
    features=("theta_turn", "theta_xl", "theta_xr", "d_x"),
    reward=RewardSettings(centreline=0.0, damping=0.0, terminal=0.0),
    cycles=3,
)
AC3 = "AC3"


class Truncating(NavigationTask):
    """The task with truncation in place of termination."""

    def advance(self, state):
        state, outcome = super().advance(state)
        ended, never = outcome.ended, outcome.truncated
        return state, outcome._replace(terminated=never, truncated=ended)


class Structured(Truncating):
    """The same with a dictionary as observation."""

    def observe(self, state):
        seen = super().observe(state)
        return {"a": seen[:1], "b": seen[1:]}


@pytest.fixture(scope="module")
def three():
    task = build_task(THREE)
    return MultiAgentEnvironment(
        Truncating(task.settings, task.simulator, task.scenarios, task.table)
    )


@pytest.mark.slow
def test_other_aircraft_follow_in_their_order(three):
    """Each of three aircraft has a block of four values and a different turn."""
    three.reset(seed=1)
    seen, *_ = three.step({AC1: 1, AC2: 2, AC3: 0})
    blocks = three.state().reshape(3, 4)
    assert len({tuple(block) for block in blocks.tolist()}) == 3
    for agent, order in ((AC1, [0, 1, 2]), (AC2, [1, 0, 2]), (AC3, [2, 0, 1])):
        np.testing.assert_allclose(seen[agent].reshape(3, 4), blocks[order], atol=1e-6)
    turns = 360.0 * blocks[:, 0] - 180.0
    assert turns.tolist() == pytest.approx([-10.0, 10.0, 0.0], abs=0.51)


def test_flattens_structured_observations(three):
    task = three.task
    structured = Structured(task.settings, task.simulator, task.scenarios, task.table)
    expected, found = (each.reset(seed=1)[0] for each in (three, MultiAgentEnvironment(structured)))
    for agent in (AC1, AC2, AC3):
        np.testing.assert_allclose(found[agent], expected[agent], atol=1e-6)


def test_exit_edge_has_its_left_and_right_end_as_seen_outbound(three):
    """The exit edge joins the two corners of the area that are nearest to the exit fix. The left
    one is on the left of the outbound airway."""
    seen, _ = three.reset(seed=2)
    sector, traffic = three.task.sector, three.task_state.traffic
    for number, agent in enumerate((AC1, AC2, AC3)):
        *_, exit_fix, beyond = (
            sector.fixes_nm[name] for name in sector.routes[int(traffic.route[number])]
        )
        outbound = beyond - exit_fix
        distances = np.linalg.norm(sector.area_nm - exit_fix, axis=1)
        one, other = sector.area_nm[np.argsort(distances)[:2]]
        on_left = outbound[0] * (one - exit_fix)[1] - outbound[1] * (one - exit_fix)[0] > 0.0
        left, right = (one, other) if on_left else (other, one)
        position = np.asarray(traffic.position_nm[number])
        cleared = float(traffic.cleared_heading_deg[number])
        for value, corner in zip(seen[agent][1:3], (left, right), strict=True):
            east, north = corner - position
            turn = (np.degrees(np.arctan2(east, north)) - cleared + 180.0) % 360.0 - 180.0
            assert 360.0 * value - 180.0 == pytest.approx(turn, abs=0.1)


def test_truncation_ends_all_agents_together(three):
    """Each agent gets its own copy of the metrics; the next reset restores all agents."""
    three.reset(seed=1)
    for cycle in (1, 2, 3):
        assert three.agents == [AC1, AC2, AC3]
        _, rewards, terminated, truncated, infos = three.step({AC2: 1})
        assert rewards == dict.fromkeys([AC1, AC2, AC3], 0.0)
        assert terminated == dict.fromkeys([AC1, AC2, AC3], False)
        assert truncated == dict.fromkeys([AC1, AC2, AC3], cycle == 3)
        assert all(bool(info) == (cycle == 3) for info in infos.values())
    assert infos[AC1]["cycles"] == infos[AC1]["instructions"] == 3.0
    infos[AC1].clear()
    assert infos[AC2]["cycles"] == 3.0
    assert three.agents == []
    three.reset()
    assert three.agents == [AC1, AC2, AC3]
    assert three.possible_agents == [AC1, AC2, AC3]


def test_every_agent_instructs_only_its_own_aircraft(three):
    for number, agent in enumerate((AC1, AC2, AC3)):
        assert three.action_space(agent).n == 3
        three.reset(seed=3)
        three.step({agent: np.int64(2)})
        assert three.task_state.memory.counts.instructions.tolist() == [
            float(other == number) for other in range(3)
        ]
        with pytest.raises(InputError, match="allowed: whole numbers from 0 to 2"):
            three.step({agent: 3})


def test_scenarios_differ_unless_reseeded(three):
    first = three.reset(seed=7)[0][AC1]
    second = three.reset()[0][AC1]
    assert not np.array_equal(first, second)
    assert np.array_equal(three.reset(seed=7)[0][AC1], first)
    assert np.array_equal(three.reset()[0][AC1], second)


def test_observations_are_copies(three):
    seen, _ = three.reset(seed=7)
    state = three.state()
    state[:] = seen[AC1][:] = 7.0
    assert three.state().max() <= 1.0


def test_all_agents_instruct_in_one_cycle(environment):
    environment.reset(seed=4)
    before = np.asarray(environment.task_state.traffic.cleared_heading_deg)
    environment.step({AC1: 1, AC2: 2})
    memory = environment.task_state.memory
    cleared = np.asarray(environment.task_state.traffic.cleared_heading_deg)
    change = (cleared - np.round(before) + 180.0) % 360.0 - 180.0
    assert change.tolist() == pytest.approx([-10.0, 10.0], abs=0.51)
    assert memory.counts.instructions.tolist() == [1.0, 1.0]
    assert memory.progress.cycles == 1.0


def test_rejects_unknown_agents_and_actions(environment, types_unchecked):
    environment.reset(seed=0)
    for agent in ("AC3", 0):
        with pytest.raises(InputError, match=f"unknown agent '{agent}'"):
            environment.step({agent: 0})
    with pytest.raises(InputError, match="allowed: whole numbers from 0 to 2"):
        environment.step({AC1: 3})


def test_use_before_reset_is_an_error():
    environment = MultiAgentEnvironment(build_task(NavigationSettings("avoidance")))
    for use in (environment.state, lambda: environment.step({})):
        with pytest.raises(ResetNeeded, match="reset"):
            use()


def test_renders_the_flight(environment):
    rendered = MultiAgentEnvironment(environment.task, "rgb_array", environment.programs)
    rendered.reset(seed=0)
    initial = rendered.render()
    rendered.step({AC1: 2})
    assert initial.ndim == 3
    assert not np.array_equal(rendered.render(), initial)
    rendered.reset(seed=0)
    assert np.array_equal(rendered.render(), initial)
    assert environment.render() is None
