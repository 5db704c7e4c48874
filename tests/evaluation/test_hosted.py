"""Agents called from Python: the compiled program's results, the queries, and precise errors."""

import jax
import numpy as np
import pytest

import skystack
from skystack.agents.agent import Agent, Batched, agent_of
from skystack.errors import InputError
from skystack.evaluation.evaluate import Conditions, evaluate, evaluate_no_op, policy_task
from skystack.evaluation.hosted import AgentController, fly_with_agent
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


def aim(observation):
    """Turn the first aircraft that is off course to its next fix, or to the one after if near."""
    for aircraft, (next_fix, fix_after, distance) in enumerate(observation.reshape(-1, 3)):
        turn_deg = 360.0 * (fix_after if 100.0 * distance < 6.0 else next_fix) - 180.0
        if abs(turn_deg) > 8.0:
            return 1 + 2 * aircraft + int(turn_deg > 0.0)
    return 0


def fly_agent(*arguments):
    return concatenate(list(fly_with_agent(*arguments)))


def fly_policy(function, scenarios=3, stacking=True, experiment=SHORT):
    task = build_task(experiment.task)
    return fly_agent(task, AgentController(agent_of(function)), 0, scenarios, stacking)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "stacking", "greedy"),
    [
        ("lateral-best", True, True),
        ("lateral-best", False, True),
        ("vertical", True, False),
        ("avoidance", False, False),
    ],
)
def test_our_policies_fly_as_in_the_compiled_program(name, stacking, greedy):
    """The same clearances in the same cycles, also when sampling with the same keys."""
    policy = find_policy(name)
    task = policy_task(policy)
    compiled = fly(
        task, network_controller(policy.actor, policy.normaliser, greedy), 3, 30, stacking
    )
    agent = Agent(name, scores=policy.logits, logits=True)
    hosted = fly_agent(task, AgentController(agent, greedy), 3, 30, stacking)
    ours, theirs = make_tables(task, compiled), make_tables(task, hosted)
    assert ours.clearances.num_rows > 20
    assert theirs.clearances.equals(ours.clearances)
    for table, other in (
        (ours.aircraft, theirs.aircraft),
        (ours.episodes, theirs.episodes),
        (ours.trajectories, theirs.trajectories),
    ):
        assert other.schema == table.schema
        for column in table.column_names:
            if table[column].type in ("float", "double"):
                np.testing.assert_allclose(other[column], table[column], rtol=1e-4, atol=1e-4)
            else:
                assert other[column].equals(table[column]), column


@pytest.mark.slow
def test_stacks_equal_those_of_the_plain_loop():
    """`skystack.stack` with a plain task, one scenario and one query at a time."""
    task, scenarios = build_task(AIMED.task), 3
    recording = fly_policy(aim, scenarios, experiment=AIMED)
    sky = PlainTask(task)
    for number in range(scenarios):
        observation, over, cycle, issued = sky.reset(scenario_key(0, number)), False, 0, 0
        while not over:
            observation, clearance = stack(sky, aim, observation)
            found = recording.action[number, cycle], recording.instructions[number, cycle]
            assert found == (clearance.action, clearance.instructions)
            issued += clearance.instructions > 0
            observation, outcome = sky.advance(observation)
            over, cycle = bool(outcome.ended), cycle + 1
        assert recording.ran[number].sum() == cycle
        assert 0 < issued == (recording.instructions[number] > 0).sum()


@pytest.mark.slow
def test_a_rule_succeeds_and_stacking_saves_clearances(tmp_path):
    stacked, plain = (
        evaluate(aim, Conditions(episodes=5, stacking=stacking), tmp_path, experiment=AIMED)
        for stacking in (True, False)
    )
    assert stacked.row["success_rate"] == plain.row["success_rate"] == 1.0
    assert 0 < stacked.row["clearances_mean"] < plain.row["clearances_mean"]
    folders = {path.name for path in tmp_path.iterdir()}
    assert folders == {"aim-s0-skystack-stacked", "aim-s0-skystack-plain"}


@pytest.mark.slow
def test_a_no_op_function_equals_the_no_op_evaluation():
    ours = evaluate_no_op(SHORT, Conditions(episodes=7), None)
    theirs = skystack.evaluate(lambda observation: 0, Conditions(episodes=7), experiment=SHORT)
    assert theirs.clearances.num_rows == 0
    assert theirs.episodes.drop(["return", "min_separation_nm"]).equals(
        ours.episodes.drop(["return", "min_separation_nm"])
    )


@pytest.mark.slow
def test_queries_again_only_where_a_stack_may_continue():
    """A no-op ends the queries of a cycle; only scenarios with an instruction are queried again."""
    query_sizes = []

    def nothing(observations):
        query_sizes.append(len(observations))
        return np.zeros(len(observations), dtype=int)

    recording = fly_policy(Batched(nothing), 6, experiment=AIMED)
    cycles = recording.ran.sum(axis=1)
    assert query_sizes == [(cycles > cycle).sum() for cycle in range(cycles.max())]

    def once(observations):
        query_sizes.append(len(observations))
        first = query_sizes[-1] > query_sizes[-2] if len(query_sizes) > 1 else True
        return ((np.arange(len(observations)) == 0) & first).astype(int)

    query_sizes[:] = [0]
    recording = fly_policy(Batched(once), 6)
    cycles = SHORT.task.cycles
    assert query_sizes[1:] == [6, 1] * cycles
    assert recording.instructions.sum(axis=1).tolist() == [cycles, 0, 0, 0, 0, 0]


@pytest.mark.slow
def test_answers_are_copied_and_observations_may_be_modified():
    kept, buffer = [], np.zeros(1000, dtype=np.int64)

    def batch(observations):
        answer = buffer[: len(observations)]
        answer[:] = [aim(observation) for observation in observations]
        kept.append(observations)
        observations *= 0.0
        return answer

    def single(observation):
        scalar = buffer[:1].reshape(())
        scalar[...] = aim(observation)
        observation[:] = np.nan
        return scalar

    expected = fly_policy(aim, 4, experiment=AIMED)
    for policy in (Batched(batch), single):
        found = fly_policy(policy, 4, experiment=AIMED)
        np.testing.assert_array_equal(found.action[found.ran], expected.action[expected.ran])
        np.testing.assert_array_equal(found.instructions, expected.instructions)


def answering_in_cycle_2(answer):
    """A batched policy that gives this answer for the third of three scenarios in cycle 2."""
    calls = iter(range(100))

    def policy(observations):
        answers = [0] * len(observations)
        if next(calls) == 2:
            answers[2] = answer
        return answers

    return Batched(policy)


@pytest.mark.slow
@pytest.mark.parametrize("answer", [5, -1, float("nan"), 2.0, 1.5])
def test_reports_an_invalid_action(answer):
    printed = float(answer) if isinstance(answer, float) else answer
    message = rf"^scenario 2, cycle 2: action is {printed} \(allowed: whole numbers from 0 to 4\)$"
    with pytest.raises(InputError, match=message):
        fly_policy(answering_in_cycle_2(answer))


def test_reports_answers_of_a_wrong_shape():
    with pytest.raises(
        InputError, match=r"^scenario 0 and 2 more, cycle 0: it returned a list of 1"
    ):
        fly_policy(Batched(lambda observations: [0]))
    with pytest.raises(InputError, match=r"^scenario 0, cycle 0: action is \[0\] "):
        fly_policy(Batched(lambda observations: np.zeros((3, 1), dtype=int)))
    with pytest.raises(InputError, match=r"cycle 0: it returned 2.5 .allowed: a list, one "):
        fly_policy(Batched(lambda observations: np.float32(2.5)))
    with pytest.raises(InputError, match=r"^scenario 0, cycle 0: action is None "):
        fly_policy(lambda observation: None)


def test_reports_invalid_scores():
    task = build_task(SHORT.task)
    for scores in ([[0.0, np.nan, 0.0, 0.0, 0.0]] * 3, [[0.0] * 4] * 3):
        agent = Agent("broken", scores=lambda observations, scores=scores: np.array(scores))
        with pytest.raises(InputError, match=r"^scenario 0, cycle 0: its scores .*: 5 finite"):
            fly_agent(task, AgentController(agent), 0, 3, True)


def test_reports_an_exception_in_the_policy():
    calls = iter(range(100))

    def fails(observation):
        return 1 // (next(calls) != 4)  # cycle 1, second scenario of three

    with pytest.raises(InputError, match="the policy failed: ZeroDivisionError") as caught:
        fly_policy(lambda observation: 0 * fails(observation))
    assert str(caught.value).startswith("scenario 1, cycle 1: ")
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert caught.traceback[-1].name != "fails"
    with pytest.raises(KeyboardInterrupt):
        fly_policy(lambda observation: (_ for _ in ()).throw(KeyboardInterrupt))


def test_accepts_actions_computed_by_jax():
    compiled = jax.jit(lambda observation: (observation[0] > 2.0).astype(int))
    assert fly_policy(compiled).instructions.sum() == 0
