"""Reading `results.json`, `bound.json` and `metrics.jsonl`."""

import json
from pathlib import Path

import pytest

from skystack.errors import InputError
from skystack.evaluation.estimate import Estimate
from skystack.learning.experiment import experiment_names
from skystack.reporting.results import (
    READABLE_NAMES,
    Bound,
    Comparison,
    Difference,
    Paper,
    RowName,
    Run,
    Statistics,
    Update,
    in_order,
    read_run,
    read_updates,
)
from tests.reporting.rows import results, row, training


def change(path, **values):
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def test_unknown_experiments_come_last_sorted_by_name(run):
    stored = json.loads((run / "results.json").read_text())["rows"][0]
    others = [stored | {"experiment": name} for name in ("zebra", "antelope")]
    change(run / "results.json", rows=[*others, stored, stored | {"platform": "bluebird"}])
    names = [row.name for row in read_run(run).results.rows]
    assert names[:2] == ["damped and stacked", "damped and stacked (bluebird)"]
    assert names[2:] == ["antelope, stacked", "zebra, stacked"]


def test_evaluation_folders_have_the_seeds_of_the_row():
    """In ascending order, the lowest first. Seeds of unstacked rows and other simulators do not
    count; the only folder has seed 0 if nothing was trained.
    """
    several = [
        row(seed=7),
        row(seed=5),
        row(seed=4, stacking=False),
        row(seed=3, platform="bluebird"),
        row(seed=2, experiment="vertical"),
        row(seed=None),
    ]
    run = Run(Path("folder"), results(rows_by_seed=several), None)
    expected = (several[0], several[2], several[3], row(experiment="do-nothing"))
    found = [run.evaluation(one).relative_to("folder/evaluation") for one in expected]
    assert [folder.name for folder in found] == [
        "lateral-s5-skystack-stacked",
        "lateral-s4-skystack-plain",
        "lateral-s3-bluebird-stacked",
        "do-nothing-s0-skystack-stacked",
    ]
    every = [folder.name for folder in run.evaluations(several[0])]
    assert every == ["lateral-s5-skystack-stacked", "lateral-s7-skystack-stacked"]
    assert run.evaluations(expected[3]) == [run.evaluation(expected[3])]


def test_finds_a_row_by_experiment_and_stacking():
    both = [row(), row(stacking=False), row(experiment="vertical", stacking=False)]
    run = results(rows=both)
    assert run.row("lateral", True) is both[0]
    assert run.row("lateral", False) is both[1]
    assert run.row("vertical", True) is None


def test_families_have_sorted_rows_and_trained_experiments():
    names = ["avoidance", "vertical", "do-nothing", "lateral-large", "lateral"]
    rows = [row(experiment=name) for name in names]
    trained = [training(name) for name in ("zebra", "avoidance", "lateral-large", "lateral")]
    run = results(rows=rows, train=trained)
    assert {
        family: [one.experiment for one in group] for family, group in run.families.items()
    } == {
        "lateral": ["do-nothing", "lateral-large", "lateral"],
        "vertical": ["vertical"],
        "avoidance": ["avoidance"],
    }
    assert list(run.families) == ["lateral", "vertical", "avoidance"]
    assert list(results(rows=rows[:1]).families) == ["avoidance"]
    assert run.experiments == ["lateral", "lateral-large", "avoidance", "zebra"]
    assert run.experiments_of("lateral") == ["lateral", "lateral-large"]
    assert run.experiments_of("vertical") == []
    assert results().experiments_of("vertical") == []


def test_row_names():
    own, other = row(), row(stacking=False, platform="bluesky", experiment="mine")
    assert (own.policy, own.name, own.title, own.slug) == (
        "damped and stacked",
        "damped and stacked",
        "Damped and stacked",
        "lateral-stacked",
    )
    assert (other.policy, other.name, other.title, other.slug) == (
        "mine, unstacked",
        "mine, unstacked (bluesky)",
        "Mine, unstacked (bluesky)",
        "mine-bluesky-plain",
    )
    assert row(experiment="mine").name == "mine, stacked"


@pytest.mark.parametrize(
    ("experiment", "task", "name"),
    [
        ("do-nothing", None, "do nothing"),  # old files
        ("do-nothing", "vertical", "vertical, do nothing"),
        ("do-nothing-lateral", "lateral", "do nothing"),
        ("do-nothing-vertical", "vertical", "vertical, do nothing"),
        ("do-nothing-avoidance", "avoidance", "avoidance, do nothing"),
        ("do-nothing-holding", "holding", "do-nothing-holding, unstacked"),
    ],
)
def test_doing_nothing_is_named_after_its_task(experiment, task, name):
    idle = row(experiment=experiment, task=task, stacking=False)
    assert idle.is_no_op
    assert not idle.is_shipped
    assert idle.name == name


@pytest.mark.parametrize("experiment", ["lateral", "nothing", "do-nothings", "lateral-do-nothing"])
def test_other_names_are_those_of_policies(experiment):
    assert not row(experiment=experiment).is_no_op


def test_shipped_policies_are_named_as_such():
    shipped = [row(experiment=f"{name}-shipped") for name in ("lateral", "lateral-best", "mine")]
    assert [each.name for each in shipped] == [
        "damped and stacked, shipped",
        "ours, stacked, shipped",
        "mine-shipped, stacked",
    ]
    assert all(each.is_shipped and not each.is_no_op for each in shipped)
    assert not row(experiment="shipped").is_shipped
    assert not row(experiment="lateral-shipped-later").is_shipped


def test_exit_offsets_are_absent_from_old_files(run):
    stored = json.loads((run / "results.json").read_text())["rows"][0]
    assert read_run(run).results.rows[0].exit_offset_nm_mean is None
    change(run / "results.json", rows=[stored | {"exit_offset_nm_mean": 2.5}])
    assert read_run(run).results.rows[0].exit_offset_nm_mean == 2.5


def idle(success_rate, experiment="do-nothing-lateral", task="lateral"):
    return row(experiment=experiment, task=task, stacking=False, success_rate=success_rate)


@pytest.mark.parametrize(
    ("others", "success_rate", "trained"),
    [
        ([], 0.3, True),
        ([], 0.299, False),
        ([idle(0.2)], 0.5, True),
        ([idle(0.2)], 0.499, False),
        ([idle(0.2, "do-nothing", None)], 0.5, True),
        ([idle(0.2, "do-nothing", None)], 0.499, False),
        ([idle(None)], 0.3, True),
        ([idle(None)], 0.299, False),
        ([idle(0.9, "do-nothing-vertical", "vertical")], 0.3, True),  # of another family
        ([idle(0.9, "lateral-best")], 0.3, True),  # a policy
        ([idle(0.8)], 1.0, False),
        ([], None, False),
    ],
)
def test_trained_means_30_points_above_doing_nothing(others, success_rate, trained):
    """Where doing nothing was not evaluated, or its success is unknown, 30 % suffice."""
    one = row(success_rate=success_rate)
    assert results(rows=[one, *others]).is_trained(one) == trained


@pytest.mark.parametrize("failing", range(71))
def test_exactly_30_points_suffice_at_each_percentage(failing):
    """In binary, 0.27 + 0.3 exceeds 0.57."""
    least, less = (row(success_rate=(10 * failing + more) / 1000) for more in (300, 299))
    run = results(rows=[least, idle(failing / 100)])
    assert run.is_trained(least)
    assert not run.is_trained(less)


def test_draws_trained_policies_and_doing_nothing():
    """In the given order. Doing nothing is drawn whether it succeeds or not."""
    high, low = row(success_rate=0.9), row(stacking=False, success_rate=0.4)
    run = results(rows=[low, idle(0.2), high])
    assert run.drawn(run.rows) == [idle(0.2), high]
    assert run.drawn([low]) == []
    assert results(rows=[low]).drawn([low]) == [low]


def test_bound_applies_to_lateral_navigation_only():
    bound = Bound(1.6, 100)
    run = Run(Path(), results(), bound)
    assert run.bound_of("lateral") is bound
    assert run.bound_of("vertical") is run.bound_of("avoidance") is None


def test_rows_are_sorted_by_policy_then_simulator_then_name():
    expected = [
        row(experiment="lateral", stacking=False),
        row(),
        row(platform="bluebird"),
        row(platform="bluesky"),
        row(platform="another"),
        row(platform="other"),
        row(experiment="vertical", stacking=False),
        row(experiment="antelope", stacking=False),
        row(experiment="antelope", stacking=False, platform="bluebird"),
        row(experiment="antelope"),
        row(experiment="zebra", stacking=False),
    ]
    assert in_order(expected[::-1]) == expected


def test_readable_names_are_distinct():
    assert len(set(READABLE_NAMES.values())) == len(READABLE_NAMES)


def test_experiments_have_plain_and_stacked_names():
    """Only the stacked name ends in "stacked". Shipped policies are stacked, doing nothing not."""
    others = {experiment for experiment, _ in READABLE_NAMES} - {*experiment_names()}
    assert {name for name in READABLE_NAMES if name[0] in others} == {
        ("lateral-shipped", True),
        ("lateral-best-shipped", True),
        ("do-nothing-lateral", False),
        ("do-nothing-vertical", False),
        ("do-nothing-avoidance", False),
    }
    for experiment in set(experiment_names()) - {"sector-control"}:  # it is not reproduced
        plain, stacked = (READABLE_NAMES[experiment, way] for way in (False, True))
        assert stacked.split()[-1] == "stacked"
        assert plain.split()[-1] != "stacked"


ONE = Estimate(1.0, 0.0, 2.0)
NAME = RowName("lateral", True)


@pytest.mark.parametrize(
    "record",
    [
        *(row(), results(), training("lateral"), Bound(1.6, 2), Update(steps=1), Paper(7.2)),
        *(NAME, Difference(ONE, ONE), Comparison(NAME, NAME, {}), Statistics(ONE, ONE)),
    ],
)
def test_records_are_immutable(record):
    with pytest.raises(AttributeError, match="immutable"):
        setattr(record, record.__struct_fields__[0], None)


def test_bound_is_optional(run):
    assert read_run(run).bound.clearances_mean == 1.6
    (run / "bound.json").unlink()
    assert read_run(run).bound is None


def test_success_is_none_if_no_scenario_ended(run):
    loaded = read_run(run)
    updates = loaded.updates(loaded.results.train[0])
    assert (updates[0].steps, updates[0].success) == (8192, None)
    assert 0.0 <= updates[-1].success <= 1.0


@pytest.mark.parametrize("name", ["results.json", "train/lateral-s0/metrics.jsonl"])
@pytest.mark.parametrize("content", [None, "", "{", '{"rows": 3, "steps": "many"}'])
def test_names_missing_and_damaged_files_in_one_line(run, name, content):
    path = run / name
    path.unlink() if content is None else path.write_text(content)

    def read():
        loaded = read_run(run)
        loaded.updates(loaded.results.train[0])

    with pytest.raises(InputError, match=path.name) as error:
        read()
    assert "\n" not in str(error.value)


def test_names_the_number_of_a_damaged_line(run):
    path = run / "train" / "lateral-s0" / "metrics.jsonl"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], "{", *lines[2:]]))
    loaded = read_run(run)
    with pytest.raises(InputError, match=r"metrics\.jsonl: line 3: damaged"):
        loaded.updates(loaded.results.train[0])


@pytest.mark.parametrize(("end", "kept"), [("", 1), ("\n", 1), ('\n{"upd', 1), ("\nx", 1)])
def test_ignores_an_incomplete_last_line(end, kept, run):
    """As during a training, or after it was killed."""
    path = run / "train" / "lateral-s0" / "metrics.jsonl"
    first = path.read_text().splitlines()[0]
    path.write_text(first + end)
    assert len(read_updates(path.parent)) == kept


def test_sorts_rows_and_trainings_on_reading(run):
    """Including the rows of simulators and of single seeds."""
    stored = json.loads((run / "results.json").read_text())
    one, train = stored["rows"][0], stored["train"][0]
    ways = [one | {"stacking": way, "platform": on} for way in (True, False) for on in SIMULATORS]
    seeds = [one | {"stacking": way, "seed": seed} for seed in (10, 2) for way in (True, False)]
    trained = [train | {"experiment": name, "seed": seed} for seed in (10, 2) for name in TRAINED]
    do_nothing = one | {"experiment": "do-nothing", "stacking": False}
    shipped = one | {"experiment": "lateral-shipped"}
    climbs = one | {"experiment": "vertical"}
    rows = [climbs, do_nothing, shipped, one]
    rows += [one | {"experiment": "lateral-undamped", "stacking": False}]
    change(run / "results.json", rows=rows, platforms=ways[::-1], rows_by_seed=seeds, train=trained)
    found = read_run(run).results
    assert [each.name for each in found.rows] == [
        "undamped",
        "damped and stacked",
        "damped and stacked, shipped",
        "do nothing",
        "vertical, stacked",
    ]
    assert [(each.stacking, each.platform) for each in found.platforms] == [
        (False, "skystack"),
        (False, "bluebird"),
        (False, "bluesky"),
        (True, "skystack"),
        (True, "bluebird"),
        (True, "bluesky"),
    ]
    assert [(each.stacking, each.seed) for each in found.rows_by_seed] == [
        (False, 2),
        (False, 10),
        (True, 2),
        (True, 10),
    ]
    assert [(each.experiment, each.seed) for each in found.train] == [
        ("lateral", 2),
        ("lateral", 10),
        ("vertical", 2),
        ("vertical", 10),
        ("mine", 2),
        ("mine", 10),
    ]


SIMULATORS, TRAINED = ("skystack", "bluebird", "bluesky"), ("mine", "vertical", "lateral")


@pytest.mark.parametrize("name", ["../elsewhere", "a/b", "..", "", "a\n", ".hidden"])
def test_names_cannot_lead_out_of_the_run_folder(run, name):
    row = json.loads((run / "results.json").read_text())["rows"][0]
    change(run / "results.json", rows=[row | {"experiment": name}])
    with pytest.raises(InputError, match=r"results\.json: damaged"):
        read_run(run)


@pytest.mark.parametrize(
    ("field", "value"), [("success_rate", 7.0), ("excursion_rate", -0.1), ("clearances_std", -1.0)]
)
def test_rejects_impossible_values(run, field, value):
    row = json.loads((run / "results.json").read_text())["rows"][0]
    change(run / "results.json", rows=[row | {field: value}])
    with pytest.raises(InputError, match=r"results\.json: damaged"):
        read_run(run)


def test_rejects_a_run_without_rows(run):
    change(run / "results.json", rows=[])
    with pytest.raises(InputError, match=r"results\.json: damaged"):
        read_run(run)


@pytest.mark.parametrize("table", ["rows", "rows_by_seed", "train", "sampled", "platforms"])
def test_rejects_duplicates(table, run):
    path = run / "results.json"
    stored = json.loads(path.read_text())
    stored["sampled"] = list(stored["rows"])
    stored["platforms"] = [stored["rows"][0] | {"platform": name} for name in SIMULATORS]
    path.write_text(json.dumps(stored))
    read_run(run)  # rows of different simulators are not duplicates
    stored[table].insert(1, stored[table][0])
    path.write_text(json.dumps(stored))
    with pytest.raises(InputError, match=rf"{table}: .* occurs twice \(allowed: once\)"):
        read_run(run)
