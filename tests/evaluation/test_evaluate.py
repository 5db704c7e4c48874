"""What is judged, on which task, under which name; nothing but a row of nobody is flown."""

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
    evaluation_folder,
    policy_task,
)
from skystack.learning.experiment import Experiment, load_experiment
from skystack.policies.facts import Facts, facts
from skystack.policies.shipped import find_policy
from skystack.simulator.fleet import AircraftType
from skystack.tasks.settings import NavigationSettings

LATERAL = find_policy("lateral")
TASK = policy_task(LATERAL)
FACTS = Facts(**facts(LATERAL))


def described(**changes):
    """The lateral policy, with other metadata."""
    return replace(LATERAL, description=msgspec.structs.replace(LATERAL.description, **changes))


def agent(**changes):
    return Agent("theirs", act=lambda seen: 0, **changes)


def test_a_policy_is_evaluated_on_the_task_it_was_trained_for():
    vertical = policy_task(find_policy("vertical"))
    kinds = {action.kind for action in vertical.actions[1:]}
    assert (vertical.name, kinds) == ("vertical", {"level"})
    assert TASK.settings == load_experiment("lateral").task


def test_another_sector_and_other_cycles_change_nothing_else():
    elsewhere = policy_task(LATERAL, "merge", 432)
    assert elsewhere.sector.name == "merge"
    assert elsewhere.settings == msgspec.structs.replace(TASK.settings, sector="merge", cycles=432)
    assert policy_task(LATERAL, cycles=299).cycles == 299
    of_agent = agent_task(agent(), "lateral", "merge", 432)
    assert of_agent.settings == elsewhere.settings


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"task_version": 7}, "was trained for task lateral version 7 .allowed: lateral version 1"),
        ({"task_name": "vertical"}, "was trained for task vertical version 1 .allowed: lateral"),
        ({"observation": ("d_c",)}, "its observation or actions differ from those of its task"),
        ({"actions": ("none",)}, "its observation or actions differ from those of its task"),
    ],
)
def test_what_was_trained_for_another_task_is_refused(changes, message):
    with pytest.raises(InputError, match=f"policy lateral-s0.* {message}"):
        policy_task(described(**changes))
    with pytest.raises(InputError, match=f"theirs.* {message}"):
        agent_task(agent(facts=msgspec.structs.replace(FACTS, **changes)), None)


def test_an_agent_is_for_the_experiment_that_is_named_or_that_it_names():
    assert agent_task(agent(facts=FACTS), None).settings == TASK.settings
    own = Experiment("mine", task=NavigationSettings(cycles=123))
    assert agent_task(agent(), own).settings.cycles == 123
    vertical = msgspec.structs.replace(FACTS, experiment="vertical", task_name="vertical")
    with pytest.raises(InputError, match=r"theirs.*differ from those of its task"):
        agent_task(agent(facts=vertical), None)
    with pytest.raises(InputError, match=r"^theirs needs an experiment: none was given \("):
        agent_task(agent(), None)
    unknown = msgspec.structs.replace(FACTS, experiment="mine")
    with pytest.raises(InputError, match="experiment: 'mine' is not shipped"):
        agent_task(agent(facts=unknown), None)


@pytest.mark.parametrize(
    ("has", "shown"),
    [
        ({"observations": 7}, "7 observed values and . actions"),
        ({"actions": 4}, ". observed values and 4 actions"),
        ({"observations": 8, "actions": 6}, "8 observed values and 6 actions"),
    ],
)
def test_an_agent_of_other_shapes_is_refused(has, shown):
    with pytest.raises(InputError, match=rf"theirs has {shown} .allowed for lateral: 8, 5"):
        agent_task(agent(**has), "lateral")
    assert agent_task(agent(observations=8, actions=5), "lateral").settings == TASK.settings


@pytest.mark.parametrize(
    ("policy", "conditions", "named", "message"),
    [
        (LATERAL, Conditions(), {"experiment": "lateral"}, "lateral carries its own experiment"),
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
def test_invalid_requests_are_refused_before_anything_is_flown(policy, conditions, named, message):
    with pytest.raises(InputError, match=message):
        evaluate(policy, conditions, **named)


def test_what_cannot_be_sent_to_other_processes_is_refused(tmp_path):
    pytest.importorskip("bluesky")
    here = Agent("here", act=threading.Lock().acquire)
    out = tmp_path / "evaluation"
    with pytest.raises(InputError, match=r"^the policy cannot be sent to other processes"):
        evaluate(here, Conditions(platform="bluesky"), out, experiment="lateral")
    assert not out.exists()


def test_the_folder_of_an_evaluation_is_named_after_the_policy():
    out = Path("out")
    assert evaluation_folder(out, "lateral", 3, True) == out / "lateral-s3-skystack-stacked"
    there = evaluation_folder(out, "own", 0, False, "bluesky")
    assert there == out / "own-s0-bluesky-plain"


def test_nobody_is_judged_plain_and_routes_that_take_too_long_are_noted(tmp_path):
    """Of types that fly at Mach 0.4: each leg is reckoned at their speed."""
    slow = AircraftType("AT76", mach=(0.4, 0.4, 0.4))
    settings = NavigationSettings(fleet=(AircraftType(), slow), cycles=98)
    experiment = Experiment("slow", task=settings)
    judged = evaluate_no_op(experiment, Conditions(seed=5, episodes=2, greedy=True), tmp_path)
    row = {name: judged.row[name] for name in ("experiment", "seed", "platform", "stacking")}
    assert row == {
        "experiment": "do-nothing",
        "seed": 0,
        "platform": "skystack",
        "stacking": False,
    }
    assert [path.name for path in tmp_path.iterdir()] == ["do-nothing-s0-skystack-plain"]
    assert judged.failed == {}
    assert judged.row["wall_s"] > 0.0
    (note,) = judged.notes
    assert note.startswith("10 of 10 routes take more than 98 cycles: ")


def test_the_usual_conditions():
    """As the command line's: a thousand scenarios, stacked, the most probable action, ours."""
    usual = Conditions()
    assert (usual.seed, usual.episodes, usual.stacking, usual.greedy) == (0, 1000, True, True)
    assert (usual.platform, usual.time_limit_s) == ("skystack", 120.0)
    assert (usual.sector, usual.cycles) == (None, None)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("seed", value) for value in (-1, 2**31, 2**32, 1.5, True)),
        *(("episodes", value) for value in (0, -3, 2.5, "3", True)),
        *(("cycles", value) for value in (0, 10_001, 1.5)),
    ],
)
def test_conditions_out_of_range_are_refused(name, value):
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
def test_conditions_of_a_wrong_type_are_refused(name, value, allowed):
    with pytest.raises(InputError, match=rf"^{name} is .* \(allowed: {allowed}\)$"):
        evaluate(lambda _: 0, Conditions(**{"episodes": 1, name: value}), experiment="vertical")


def test_paths_may_be_str_or_path(tmp_path):
    """Names, files and folders may be given in either form."""
    own = Path(__file__).parents[2] / "examples" / "own-sector"
    for kind in (str, Path):
        conditions = Conditions(episodes=1, sector=kind(own / "valley.json"))
        out, experiment = kind(tmp_path / kind.__name__), kind(own / "valley.toml")
        judged = evaluate(lambda _: 0, conditions, out, experiment=experiment, name="nobody")
        assert judged.episodes.num_rows == 1
        (folder,) = Path(out).iterdir()
        assert folder.name == "nobody-s0-skystack-stacked"
    with pytest.raises(InputError, match="unknown sector 'nowhere'"):
        evaluate(lambda _: 0, Conditions(sector=Path("nowhere")), experiment="lateral")


def test_conditions_may_be_numpy_scalars():
    given = Conditions(
        np.int64(3), np.int32(1), np.bool_(False), np.True_, "skystack", np.float32(1)
    )
    judged = evaluate(lambda _: 0, given, experiment="vertical")
    assert (judged.row["stacking"], judged.episodes.num_rows) == (False, 1)
