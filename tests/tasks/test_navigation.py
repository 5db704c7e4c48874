"""The lateral task: observations, instructions, the reward of a cycle, the end of a scenario."""

import jax
import jax.numpy as jnp
import msgspec
import numpy as np
import pytest

from skystack.errors import InputError
from skystack.simulator.traffic import ticks
from skystack.tasks.conformance import check_task
from skystack.tasks.registry import build_task, build_training_task
from skystack.tasks.settings import NavigationSettings, RewardSettings

from .conftest import REVERSED, STRAIGHT, TURNING
from .memories import with_fields

NO_OP, LEFT_1, RIGHT_1, LEFT_2, RIGHT_2 = range(5)


def action(number):
    return jnp.asarray(number, dtype=jnp.int32)


@pytest.mark.slow
@pytest.mark.parametrize("timing", ["cycle", "stack"])
@pytest.mark.parametrize("actions", ["small", "large"])
def test_satisfies_the_contract(timing, actions):
    check_task(build_training_task(NavigationSettings(timing=timing, actions=actions)))


def test_action_tables_have_the_sizes_of_the_paper():
    assert len(build_task(NavigationSettings()).action_names) == 5
    large = build_task(NavigationSettings(actions="large"))
    assert len(large.action_names) == 37
    assert [action.change for action in large.actions[1:10]] == [-10 * k for k in range(1, 10)]
    assert [action.change for action in large.actions[10:19]] == [10 * k for k in range(1, 10)]
    assert {action.aircraft for action in large.actions[19:]} == {1}


def test_observation_on_the_centreline(task, traffic_on):
    """Straight ahead: no turn to either fix, no deviation, no recent instruction."""
    observation = task.observe(task.begin(traffic_on(STRAIGHT, REVERSED)))
    assert task.observation_names[:4] == ("theta_f_1", "theta_sf_1", "d_c_1", "delta_t_1")
    np.testing.assert_allclose(observation, [0.5, 0.5, 0.5, 1.0] * 2, atol=2e-5)


def test_observation_of_a_deviation_to_the_right(task, traffic_on):
    """10 NM right of a north-easterly track: d_c = +10, the next fix lies to the left."""
    sector = task.simulator.sector
    heading = np.radians(sector.first_heading_deg(STRAIGHT))
    right = 10.0 * np.array([np.cos(heading), -np.sin(heading)])
    position = sector.fixes_nm["HERON"] + right
    traffic = traffic_on(STRAIGHT, REVERSED, positions=[position, [40.0, 40.0]])
    observation = task.observe(task.begin(traffic))
    assert float(observation[2]) == pytest.approx((10.0 + 100.0) / 200.0, abs=1e-4)
    leg = np.linalg.norm(sector.fixes_nm["CRANE"] - sector.fixes_nm["HERON"])
    assert float(observation[0]) == pytest.approx(
        0.5 - np.degrees(np.arctan2(10.0, leg)) / 360.0, abs=1e-4
    )


def test_a_cleared_heading_changes_the_observation_at_once(task, traffic_on):
    state = task.begin(traffic_on(STRAIGHT, REVERSED))
    instructed = task.instruct(state, action(RIGHT_1))
    before, after = task.observe(state), task.observe(instructed)
    # 45.19 + 10 is rounded to 55: the fix now lies 9.81 degrees to the left.
    assert float(instructed.traffic.cleared_heading_deg[0]) == 55.0
    assert float(after[0] - before[0]) * 360.0 == pytest.approx(-(55.0 - 45.19198), abs=1e-2)
    assert float(after[3]) == 0.0
    np.testing.assert_array_equal(after[4:], before[4:])


def test_instructions_count_only_for_the_addressed_aircraft(task, traffic_on):
    state = task.begin(traffic_on(STRAIGHT, REVERSED))
    state = task.instruct(state, action(LEFT_2))
    np.testing.assert_array_equal(state.memory.counts.instructions, [0.0, 1.0])
    np.testing.assert_array_equal(state.memory.counts.cycles_since_instruction, [10.0, 0.0])
    state, _ = task.advance(state)
    np.testing.assert_array_equal(state.memory.counts.cycles_since_instruction, [10.0, 0.0])
    state, _ = task.advance(state)
    np.testing.assert_array_equal(state.memory.counts.cycles_since_instruction, [10.0, 1.0])


def test_reward_of_a_quiet_cycle_on_the_centreline_is_zero(task, traffic_on):
    _, outcome = task.step(task.begin(traffic_on(STRAIGHT, REVERSED)), action(NO_OP))
    assert float(outcome.reward[0]) == pytest.approx(0.0, abs=1e-4)


def test_reward_of_an_instruction_is_damping_over_two_aircraft(task, traffic_on):
    """Weight 0.25, r_a = -1 for one of two aircraft. Both are still on the centreline."""
    _, outcome = task.step(task.begin(traffic_on(STRAIGHT, REVERSED)), action(LEFT_1))
    assert float(outcome.reward[0]) == pytest.approx(-0.25 / 2, abs=1e-4)


def test_instructions_are_free_without_damping(traffic_on):
    undamped = build_task(
        NavigationSettings(reward=RewardSettings(damping=0.0, count_criterion=False))
    )
    _, outcome = undamped.step(undamped.begin(traffic_on(STRAIGHT, REVERSED)), action(LEFT_1))
    assert float(outcome.reward[0]) == pytest.approx(0.0, abs=1e-4)


def test_a_burst_costs_once(traffic_on):
    """Not in the paper: consecutive cycles with the same instruction are one burst."""
    weights = RewardSettings(centreline=0.0, damping=0.0, burst=1.0)
    task = build_task(NavigationSettings(reward=weights))
    state, rewards = task.begin(traffic_on(STRAIGHT, REVERSED)), []
    for number in (LEFT_1, LEFT_1, RIGHT_2, NO_OP, RIGHT_2):
        state, outcome = task.step(state, action(number))
        rewards.append(float(outcome.reward[0]))
    assert rewards == [-1.0, 0.0, -1.0, 0.0, -1.0]
    assert float(outcome.metrics["bursts"]) == 3.0


def fly(task, traffic, cycles=300):
    """The memory and outcome after each cycle of a flight without instructions."""

    def cycle(state, _):
        state, outcome = task.advance(state)
        return state, (state.memory, outcome)

    return jax.jit(lambda s: jax.lax.scan(cycle, s, None, length=cycles))(task.begin(traffic))[1]


@pytest.mark.slow
def test_straight_routes_succeed_uninstructed(task, traffic_on):
    """As in the real simulator, HERON-SWIFT and SWIFT-HERON need no instruction."""
    memory, outcome = fly(task, traffic_on(STRAIGHT, REVERSED))
    end = int(np.argmax(outcome.ended))
    assert bool(outcome.metrics["success"][end])
    assert not bool(outcome.metrics["excursion"][end])
    np.testing.assert_array_equal(memory.progress.exited_correctly[end], [True, True])
    # The terminal reward is 15 + 20: both aircraft meet all criteria. The cycle costs nothing.
    assert float(outcome.reward[end, 0]) == pytest.approx(35.0, abs=1e-3)
    # They meet head-on near the middle.
    assert float(outcome.metrics["min_separation_nm"][end]) < 0.5


def test_entry_exit_and_excursion_cycles_agree_with_geometry(task, traffic_on):
    """465.94 kt is 0.77657 NM per cycle. The arm ends 4.9922 NM ahead, the exit is 89.9 NM on."""
    memory, outcome = fly(task, traffic_on(STRAIGHT, TURNING, positions=None))
    per_cycle = 465.940793 / 600.0
    entered = np.argmax(np.asarray(memory.progress.entered)[:, 0]) + 1
    exited = np.argmax(np.asarray(memory.progress.exited)[:, 0]) + 1
    assert entered == int(np.ceil(4.9922 / per_cycle))
    assert exited == int(np.ceil((4.9922 + 29.9533 + 20.8255 + 39.0807) / per_cycle))
    # Straight on at EGL leads out through the northern arm, which is not the exit of this route.
    assert bool(memory.progress.excursion[-1, 1])
    assert not bool(memory.progress.exited[-1, 1])
    assert int(np.argmax(outcome.ended)) == 299


def test_an_aircraft_outside_the_sector_still_costs(task, traffic_on):
    memory, outcome = fly(task, traffic_on(TURNING, REVERSED))
    excursion = int(np.argmax(np.asarray(memory.progress.excursion)[:, 0]))
    assert bool(memory.progress.exited[-1, 1])
    # Far from the route each cycle costs 1 / 2: 1, averaged over both aircraft.
    assert float(outcome.reward[290, 0]) == pytest.approx(-0.5, abs=1e-3)
    assert excursion < 290


def test_never_entering_is_an_excursion(task, traffic_on):
    outwards = traffic_on(STRAIGHT, REVERSED, headings=[225.0, 45.0])
    memory, outcome = fly(task, outwards)
    assert not np.any(memory.progress.excursion[:-1])
    np.testing.assert_array_equal(memory.progress.excursion[-1], [True, True])
    # Only the count criterion is met (5), and both are as far off their routes as possible (-1).
    assert float(outcome.reward[-1, 0]) == pytest.approx(5.0 - 1.0, abs=1e-3)


def test_a_wrong_exit_level_is_not_correct_but_no_excursion(task, traffic_on):
    traffic = traffic_on(STRAIGHT, REVERSED)
    state = task.begin(traffic)
    wanted = state.memory.plan.exit_level_ticks.at[0].set(ticks(310))
    state = state._replace(memory=with_fields(state.memory, exit_level_ticks=wanted))
    advance = jax.jit(task.advance)
    for _ in range(123):
        state, outcome = advance(state)
    assert bool(outcome.ended)
    np.testing.assert_array_equal(state.memory.progress.exited_correctly, [False, True])
    assert not bool(outcome.metrics["excursion"])
    assert not bool(outcome.metrics["correct_exit"])
    assert float(outcome.reward[0]) == pytest.approx(2.5 + 5.0 + 5.0, abs=1e-3)


def test_exited_aircraft_are_not_observed_or_instructed(task, traffic_on):
    state = task.begin(traffic_on(STRAIGHT, REVERSED))
    exited = state._replace(traffic=state.traffic._replace(active=jnp.asarray([False, True])))
    np.testing.assert_allclose(task.observe(exited)[:4], [0.5, 0.5, 0.5, 1.0])
    instructed = task.instruct(exited, action(LEFT_1))
    jax.tree.map(np.testing.assert_array_equal, instructed, exited)
    assert not bool(task.may_stack(exited, action(LEFT_1)))
    assert bool(task.may_stack(exited, action(LEFT_2)))


def test_instructions_before_entry_can_be_refused(traffic_on):
    task = build_task(NavigationSettings(control="entered"))
    outside = task.begin(traffic_on(STRAIGHT, REVERSED))
    one_inside = outside._replace(
        memory=with_fields(outside.memory, entered=jnp.asarray([True, False]))
    )
    refused = task.instruct(one_inside, action(LEFT_2))
    jax.tree.map(np.testing.assert_array_equal, refused, one_inside)
    assert not bool(task.may_stack(one_inside, action(LEFT_2)))
    assert bool(task.may_stack(one_inside, action(LEFT_1)))
    heard = task.instruct(one_inside, action(LEFT_1))
    assert heard.memory.counts.instructions.tolist() == [1.0, 0.0]
    assert float(heard.traffic.cleared_heading_deg[0]) == 35.0


@pytest.mark.slow
@pytest.mark.parametrize("timing", ["cycle", "stack"])
def test_time_passes_while_instructions_are_refused(timing):
    """A policy that always instructs the same aircraft issues nothing before it enters."""
    task = build_training_task(NavigationSettings(control="entered", timing=timing))
    state, entered = task.reset(jax.random.key(0)), []
    step = jax.jit(task.step)
    for _ in range(5):
        state, _ = step(state, action(LEFT_1))
        inner = getattr(state, "inner", state)
        entered.append(bool(inner.memory.progress.entered[0]))
    assert not any(entered)
    assert float(inner.memory.progress.cycles) == 5.0
    assert float(inner.memory.counts.instructions[0]) == 0.0


@pytest.mark.parametrize("before_nm", [60.0, 40.0])
def test_exits_must_lie_on_the_last_leg_inside_the_area(before_nm):
    """The legs to the exits of X-Plus are 30 to 40 NM long."""
    with pytest.raises(InputError, match=r"exit_before_nm is .*\(allowed in x-plus: inside"):
        build_task(NavigationSettings(exit_before_nm=before_nm))


@pytest.mark.slow
@pytest.mark.parametrize("ends_early", [True, False])
def test_scenarios_end_with_the_last_aircraft_or_at_the_time_limit(traffic_on, ends_early):
    task = build_task(NavigationSettings(ends_early=ends_early))
    memory, outcome = fly(task, traffic_on(STRAIGHT, REVERSED))
    left = int(np.argmax(np.all(np.asarray(memory.progress.exited), axis=1)))
    assert int(np.argmax(outcome.ended)) == (left if ends_early else 299)
    assert left < 200


@pytest.mark.slow
@pytest.mark.parametrize(("exit_nm", "exits"), [(None, True), (4.0, True), (2.0, False)])
def test_an_exit_can_be_narrower_than_the_edge(traffic_on, exit_nm, exits):
    """Three miles beside the route: outside an exit of two miles to either side of the fix."""
    task = build_task(NavigationSettings(exit_nm=exit_nm))
    heading = np.radians(task.sector.first_heading_deg(STRAIGHT))
    right = 3.0 * np.array([np.cos(heading), -np.sin(heading)])
    start = task.sector.fixes_nm[STRAIGHT[0]] + right
    traffic = traffic_on(STRAIGHT, REVERSED, positions=[start, task.sector.fixes_nm["SWIFT"]])
    progress = fly(task, traffic)[0].progress
    assert progress.exited[-1].tolist() == [exits, True]
    assert progress.excursion[-1].tolist() == [not exits, False]


def test_thirty_instructions_are_not_few(task, traffic_on):
    state = task.begin(traffic_on(STRAIGHT, REVERSED))
    for count, few in ((29.0, True), (30.0, False)):
        memory = with_fields(state.memory, instructions=jnp.asarray([count, 0.0]))
        _, outcome = task.advance(state._replace(memory=memory))
        assert bool(outcome.metrics["few_instructions"]) is few


def test_stacks_end_before_the_turn_would_reverse(task, traffic_on):
    """From 45.19 to the right: 55, 65, ... 225 is 179.81 degrees away, 235 is beyond."""
    state, count = task.begin(traffic_on(STRAIGHT, REVERSED)), 0
    while bool(task.may_stack(state, action(RIGHT_1))):
        state, count = task.instruct(state, action(RIGHT_1)), count + 1
    assert float(state.traffic.cleared_heading_deg[0]) == 225.0
    assert count == 18


def test_refuses_invalid_settings():
    for change, message in (
        ({"features": ("theta_g",)}, "did you mean"),
        ({"features": ()}, "empty"),
        ({"aircraft": 5}, "first fix"),
        ({"level_fl": 305}, "multiples of 10"),
        ({"sector": "x-minus"}, "x-plus"),
        ({"performance": "tables"}, "table"),
    ):
        with pytest.raises(InputError, match=message):
            build_task(msgspec.structs.replace(NavigationSettings(), **change))
