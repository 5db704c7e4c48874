"""Requests for an evaluation: the task, the conditions, the names, and what is refused."""

import math
import threading
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from skystack.agents.agent import Agent
from skystack.errors import InputError
from skystack.evaluation.evaluate import (
    Conditions,
    agent_task,
    evaluate,
    evaluate_no_op,
    policy_task,
)
from skystack.evaluation.summary import evaluation_folder
from skystack.learning.experiment import Experiment, load_experiment
from skystack.policies.facts import Facts, facts
from skystack.policies.shipped import find_policy
from skystack.simulator.fleet import AircraftType
from skystack.tasks.settings import NavigationSettings

LATERAL = find_policy("lateral")
TASK = policy_task(LATERAL)
FACTS = Facts(**facts(LATERAL))


def with_metadata(**changes):
    """The lateral policy with changed metadata."""
    return replace(LATERAL, description=msgspec.structs.replace(LATERAL.description, **changes))


def agent(**changes):
    return Agent("theirs", act=lambda observation: 0, **changes)


def test_a_policy_is_evaluated_on_its_training_task():
    vertical = policy_task(find_policy("vertical"))
    kinds = {action.kind for action in vertical.actions[1:]}
    assert (vertical.name, kinds) == ("vertical", {"level"})
    assert TASK.settings == load_experiment("lateral").task


def test_sector_and_cycles_change_no_other_setting():
    elsewhere = policy_task(LATERAL, "merge", 432)
    assert elsewhere.sector.name == "merge"
    assert elsewhere.settings == msgspec.structs.replace(TASK.settings, sector="merge", cycles=432)
    assert policy_task(LATERAL, cycles=299).cycles == 299
    agents_task = agent_task(agent(), "lateral", "merge", 432)
    assert agents_task.settings == elsewhere.settings


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"task_version": 7}, "was trained for task lateral version 7 .allowed: lateral version 1"),
        ({"task_name": "vertical"}, "was trained for task vertical version 1 .allowed: lateral"),
        ({"observation": ("d_c",)}, "its observation or actions differ from those of its task"),
        ({"actions": ("none",)}, "its observation or actions differ from those of its task"),
    ],
)
def test_rejects_policies_trained_for_another_task(changes, message):
    with pytest.raises(InputError, match=f"policy lateral-s0.* {message}"):
        policy_task(with_metadata(**changes))
    with pytest.raises(InputError, match=f"theirs.* {message}"):
        agent_task(agent(facts=msgspec.structs.replace(FACTS, **changes)), None)


def test_an_agent_flies_the_given_or_its_own_experiment():
    assert agent_task(agent(facts=FACTS), None).settings == TASK.settings
    mine = Experiment("mine", task=NavigationSettings(cycles=123))
    assert agent_task(agent(), mine).settings.cycles == 123
    vertical = msgspec.structs.replace(FACTS, experiment="vertical", task_name="vertical")
    with pytest.raises(InputError, match=r"theirs.*differ from those of its task"):
        agent_task(agent(facts=vertical), None)
    with pytest.raises(InputError, match=r"^theirs needs an experiment: none was given \("):
        agent_task(agent(), None)
    unknown = msgspec.structs.replace(FACTS, experiment="mine")
    with pytest.raises(InputError, match="experiment: 'mine' is not shipped"):
        agent_task(agent(facts=unknown), None)


@pytest.mark.parametrize(
    ("shapes", "described"),
    [
        ({"observations": 7}, "7 observed values and . actions"),
        ({"actions": 4}, ". observed values and 4 actions"),
        ({"observations": 8, "actions": 6}, "8 observed values and 6 actions"),
    ],
)
def test_rejects_an_agent_of_other_shapes(shapes, described):
    with pytest.raises(InputError, match=rf"theirs has {described} .allowed for lateral: 8, 5"):
        agent_task(agent(**shapes), "lateral")
    assert agent_task(agent(observations=8, actions=5), "lateral").settings == TASK.settings


@pytest.mark.parametrize(
    ("policy", "conditions", "options", "message"),
    [
        (LATERAL, Conditions(), {"experiment": "lateral"}, "lateral already names its experiment"),
        (LATERAL, Conditions(platform="bluebrd"), {}, "unknown platform 'bluebrd'; did you mean"),
        (LATERAL, Conditions(cycles=20), {}, "task.cycles is 20, but the shortest route"),
        (
            agent(),
            Conditions(greedy=False),
            {"experiment": "lateral"},
            "theirs has no probabilities to sample from",
        ),
    ],
)
def test_rejects_invalid_requests_before_flying(policy, conditions, options, message):
    with pytest.raises(InputError, match=message):
        evaluate(policy, conditions, **options)


def test_rejects_an_agent_that_cannot_be_pickled(tmp_path):
    pytest.importorskip("bluesky")
    here = Agent("here", act=threading.Lock().acquire)
    out = tmp_path / "evaluation"
    with pytest.raises(InputError, match=r"^the policy cannot be sent to other processes"):
        evaluate(here, Conditions(platform="bluesky"), out, experiment="lateral")
    assert not out.exists()


def test_the_folder_of_an_evaluation_is_named_after_the_policy():
    out = Path("out")
    assert evaluation_folder(out, "lateral", 3, True) == out / "lateral-s3-skystack-stacked"
    other = evaluation_folder(out, "own", 0, False, "bluesky")
    assert other == out / "own-s0-bluesky-plain"


@pytest.mark.slow
def test_no_op_is_unstacked_and_long_routes_are_noted(tmp_path):
    """Because one type flies at Mach 0.4, and routes are timed at the lowest speed."""
    slow = AircraftType("AT76", mach=(0.4, 0.4, 0.4))
    settings = NavigationSettings(fleet=(AircraftType(), slow), cycles=98)
    experiment = Experiment("slow", task=settings)
    result = evaluate_no_op(experiment, Conditions(seed=5, episodes=2, greedy=True), tmp_path)
    row = {name: result.row[name] for name in ("experiment", "seed", "platform", "stacking")}
    assert row == {
        "experiment": "do-nothing-lateral",
        "seed": 0,
        "platform": "skystack",
        "stacking": False,
    }
    assert [path.name for path in tmp_path.iterdir()] == ["do-nothing-lateral-s0-skystack-plain"]
    assert result.failed == {}
    assert result.row["wall_s"] > 0.0
    (note,) = result.notes
    assert note.startswith("10 of 10 routes take more than 98 cycles: ")


def test_default_conditions():
    """As on the command line: 1,000 scenarios, stacked, greedy, in our simulator."""
    defaults = Conditions()
    assert (defaults.seed, defaults.episodes) == (0, 1000)
    assert (defaults.stacking, defaults.greedy) == (True, True)
    assert (defaults.platform, defaults.time_limit_s) == ("skystack", 120.0)
    assert (defaults.sector, defaults.cycles) == (None, None)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("seed", value) for value in (-1, 2**31, 2**32, 1.5, True)),
        *(("episodes", value) for value in (0, -3, 2.5, "3", True)),
        *(("cycles", value) for value in (0, 10_001, 1.5)),
    ],
)
def test_rejects_conditions_out_of_range(name, value):
    """As on the command line. Seeds beyond 32 bits would repeat the scenarios of smaller ones."""
    with pytest.raises(InputError, match=rf"^{name} is .* \(allowed: whole numbers from "):
        evaluate(lambda _: 0, Conditions(**{"episodes": 1, name: value}), experiment="vertical")


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        *(("stacking", value, "True, False") for value in ("no", 0, None, np.array(1))),
        ("greedy", "yes", "True, False"),
        *(
            ("time_limit_s", value, "seconds above 0, up to 10,000,000")
            for value in (0, -1.0, math.nan, math.inf, "120", None, True)
        ),
    ],
)
def test_rejects_conditions_of_a_wrong_type(name, value, allowed):
    with pytest.raises(InputError, match=rf"^{name} is .* \(allowed: {allowed}\)$"):
        evaluate(lambda _: 0, Conditions(**{"episodes": 1, name: value}), experiment="vertical")


@pytest.mark.slow
def test_paths_may_be_str_or_path(tmp_path):
    """Experiments, sectors and output folders."""
    example = Path(__file__).parents[2] / "examples" / "own-sector"
    for kind in (str, Path):
        conditions = Conditions(episodes=1, sector=kind(example / "valley.json"))
        out, experiment = kind(tmp_path / kind.__name__), kind(example / "valley.toml")
        result = evaluate(lambda _: 0, conditions, out, experiment=experiment, name="nobody")
        assert result.episodes.num_rows == 1
        (folder,) = Path(out).iterdir()
        assert folder.name == "nobody-s0-skystack-stacked"
    with pytest.raises(InputError, match="unknown sector 'nowhere'"):
        evaluate(lambda _: 0, Conditions(sector=Path("nowhere")), experiment="lateral")


@pytest.mark.slow
def test_conditions_may_be_numpy_scalars():
    conditions = Conditions(
        np.int64(3), np.int32(1), np.bool_(False), np.True_, "skystack", np.float32(1)
    )
    result = evaluate(lambda _: 0, conditions, experiment="vertical")
    assert (result.row["stacking"], result.episodes.num_rows) == (False, 1)


@pytest.mark.slow
def test_the_papers_numbers_are_only_for_its_sector_and_task():
    policy = find_policy("lateral")
    plain = Conditions(episodes=2, stacking=False)
    assert evaluate(policy, plain).row["paper"]["clearances_mean"] == 14.5
    for other in ({"sector": "merge"}, {"cycles": 299}):
        assert evaluate(policy, plain._replace(**other)).row["paper"] is None
    dearer = load_experiment("lateral", ["task.reward.burst=2.0"])
    own = evaluate(lambda observation: 0, plain, experiment=dearer, name="lateral")
    assert own.row["paper"] is None
