"""Agents asked from Python: as in the compiled program, once a query, and with errors that name."""

import jax
import numpy as np
import pytest

import skystack
from skystack.agents.agent import Agent, Batched, agent_of
from skystack.errors import InputError
from skystack.evaluation.evaluate import Conditions, evaluate, evaluate_no_op, policy_task
from skystack.evaluation.hosted import HostedController, fly_hosted
from skystack.evaluation.rollout import concatenate, fly, network_controller
from skystack.evaluation.tables import make_tables
from skystack.learning.experiment import Experiment
from skystack.learning.seeds import scenario_key
from skystack.policies.shipped import find_policy
from skystack.stacking import stack
from skystack.tasks.plain import PlainTask
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings

SHORT = Experiment("short", task=NavigationSettings(cycles=98))
AIMED = Experiment("aimed", task=NavigationSettings(features=("theta_f", "theta_sf", "d_f")))


def aim(seen):
    """Turns whoever points off the next fix towards it, or the one after where it is near."""
    for aircraft, (next_fix, fix_after, distance) in enumerate(seen.reshape(-1, 3)):
        turn_deg = 360.0 * (fix_after if 100.0 * distance < 6.0 else next_fix) - 180.0
        if abs(turn_deg) > 8.0:
            return 1 + 2 * aircraft + int(turn_deg > 0.0)
    return 0


def whole(*arguments):
    return concatenate(list(fly_hosted(*arguments)))


def flown(function, scenarios=3, stacking=True, experiment=SHORT):
    task = build_task(experiment.task)
    return whole(task, HostedController(agent_of(function)), 0, scenarios, stacking)


@pytest.mark.parametrize(
    ("name", "stacking", "greedy"),
    [
        ("lateral-best", True, True),
        ("lateral-best", False, True),
        ("vertical", True, False),
        ("avoidance", False, False),
    ],
)
def test_our_policies_fly_as_in_one_program(name, stacking, greedy):
    """Cycle by cycle, sampling under the same keys: the same clearances."""
    policy = find_policy(name)
    task = policy_task(policy)
    compiled = fly(
        task, network_controller(policy.actor, policy.normaliser, greedy), 3, 30, stacking
    )
    agent = Agent(name, scores=policy.logits, logits=True)
    hosted = whole(task, HostedController(agent, greedy), 3, 30, stacking)
    ours, theirs = make_tables(task, compiled), make_tables(task, hosted)
    assert ours.clearances.num_rows > 20
    assert theirs.clearances.equals(ours.clearances)
    assert theirs.aircraft.equals(ours.aircraft)
    for table, other in (
        (ours.episodes, theirs.episodes),
        (ours.trajectories, theirs.trajectories),
    ):
        assert other.schema == table.schema
        for column in table.column_names:
            if table[column].type in ("float", "double"):
                np.testing.assert_allclose(other[column], table[column], rtol=1e-4, atol=1e-4)
            else:
                assert other[column].equals(table[column]), column


def test_stacks_are_those_of_the_plain_loop():
    """`skystack.stack` round a plain task, one scenario and query at a time."""
    task, scenarios = build_task(AIMED.task), 3
    recording = flown(aim, scenarios, experiment=AIMED)
    sky = PlainTask(task)
    for number in range(scenarios):
        seen, over, cycle, issued = sky.reset(scenario_key(0, number)), False, 0, 0
        while not over:
            seen, clearance = stack(sky, aim, seen)
            found = recording.action[number, cycle], recording.instructions[number, cycle]
            assert found == (clearance.action, clearance.instructions)
            issued += clearance.instructions > 0
            seen, outcome = sky.advance(seen)
            over, cycle = bool(outcome.ended), cycle + 1
        assert recording.ran[number].sum() == cycle
        assert 0 < issued == (recording.instructions[number] > 0).sum()


def test_a_rule_succeeds_and_stacking_saves_clearances(tmp_path):
    stacked, plain = (
        evaluate(aim, Conditions(episodes=5, stacking=stacking), tmp_path, experiment=AIMED)
        for stacking in (True, False)
    )
    assert stacked.row["success_rate"] == plain.row["success_rate"] == 1.0
    assert 0 < stacked.row["clearances_mean"] < plain.row["clearances_mean"]
    folders = {path.name for path in tmp_path.iterdir()}
    assert folders == {"aim-s0-skystack-stacked", "aim-s0-skystack-plain"}


def test_doing_nothing_is_doing_nothing():
    ours = evaluate_no_op(SHORT, Conditions(episodes=7), None)
    theirs = skystack.evaluate(lambda seen: 0, Conditions(episodes=7), experiment=SHORT)
    assert theirs.clearances.num_rows == 0
    assert theirs.episodes.drop(["return", "min_separation_nm"]).equals(
        ours.episodes.drop(["return", "min_separation_nm"])
    )


def test_only_those_who_still_ask_are_asked():
    """Who says nothing is asked once a cycle; the first of the others again, up to its limit."""
    asked = []

    def nothing(observations):
        asked.append(len(observations))
        return np.zeros(len(observations), dtype=int)

    recording = flown(Batched(nothing), 6, experiment=AIMED)
    cycles = recording.ran.sum(axis=1)
    assert asked == [(cycles > cycle).sum() for cycle in range(cycles.max())]

    def once(observations):
        asked.append(len(observations))
        first = asked[-1] > asked[-2] if len(asked) > 1 else True
        return ((np.arange(len(observations)) == 0) & first).astype(int)

    asked[:] = [0]
    recording = flown(Batched(once), 6)
    cycles = SHORT.task.cycles
    assert asked[1:] == [6, 1] * cycles
    assert recording.instructions.sum(axis=1).tolist() == [cycles, 0, 0, 0, 0, 0]


def test_answers_are_copied_and_observations_may_be_changed():
    kept, buffer = [], np.zeros(1000, dtype=np.int64)

    def batch(observations):
        answer = buffer[: len(observations)]
        answer[:] = [aim(seen) for seen in observations]
        kept.append(observations)
        observations *= 0.0
        return answer

    def single(seen):
        scalar = buffer[:1].reshape(())
        scalar[...] = aim(seen)
        seen[:] = np.nan
        return scalar

    expected = flown(aim, 4, experiment=AIMED)
    for policy in (Batched(batch), single):
        found = flown(policy, 4, experiment=AIMED)
        np.testing.assert_array_equal(found.action[found.ran], expected.action[expected.ran])
        np.testing.assert_array_equal(found.instructions, expected.instructions)


def late(answer):
    """A batched policy that answers so for the third of three scenarios in cycle 2."""
    calls = iter(range(100))

    def policy(observations):
        answers = [0] * len(observations)
        if next(calls) == 2:
            answers[2] = answer
        return answers

    return Batched(policy)


@pytest.mark.parametrize("answer", [5, -1, float("nan"), 2.0, 1.5])
def test_an_answer_that_is_no_action_is_named(answer):
    shown = float(answer) if isinstance(answer, float) else answer
    message = rf"^scenario 2, cycle 2: action is {shown} \(allowed: whole numbers from 0 to 4\)$"
    with pytest.raises(InputError, match=message):
        flown(late(answer))


def test_answers_of_a_wrong_shape_are_named():
    with pytest.raises(InputError, match=r"^scenario 0 and 2 more, cycle 0: its answers are 1 "):
        flown(Batched(lambda observations: [0]))
    with pytest.raises(InputError, match=r"^scenario 0, cycle 0: action is \[0\] "):
        flown(Batched(lambda observations: np.zeros((3, 1), dtype=int)))
    with pytest.raises(InputError, match=r"cycle 0: its answers are 2.5 .allowed: 3, one per"):
        flown(Batched(lambda observations: np.float32(2.5)))
    with pytest.raises(InputError, match=r"^scenario 0, cycle 0: action is None "):
        flown(lambda seen: None)


def test_scores_that_are_no_numbers_are_named():
    task = build_task(SHORT.task)
    for scores in ([[0.0, np.nan, 0.0, 0.0, 0.0]] * 3, [[0.0] * 4] * 3):
        agent = Agent("broken", scores=lambda observations, scores=scores: np.array(scores))
        with pytest.raises(InputError, match=r"^scenario 0, cycle 0: its scores .*: 5 finite"):
            whole(task, HostedController(agent), 0, 3, True)


def test_a_policy_that_raises_is_not_swallowed():
    seen = iter(range(100))

    def fails(observation):
        return 1 // (next(seen) != 4)  # cycle 1, second scenario of three

    with pytest.raises(InputError, match="the policy failed: ZeroDivisionError") as caught:
        flown(lambda observation: 0 * fails(observation))
    assert str(caught.value).startswith("scenario 1, cycle 1: ")
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert caught.traceback[-1].name != "fails"
    with pytest.raises(KeyboardInterrupt):
        flown(lambda observation: (_ for _ in ()).throw(KeyboardInterrupt))


def test_what_jax_computes_is_an_action_too():
    compiled = jax.jit(lambda seen: (seen[0] > 2.0).astype(int))
    assert flown(compiled).instructions.sum() == 0
