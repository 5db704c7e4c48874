"""Reading `results.json`, `bound.json` and `metrics.jsonl`."""

import json
from pathlib import Path

import pytest

from skystack.errors import InputError
from skystack.evaluation.statistics import Estimate
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
    family_of,
    family_order,
    family_title,
    in_order,
    read_run,
    read_updates,
)
from tests.reporting.rows import results, row, training


def change(path, **values):
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def test_unknown_experiments_follow_by_name(run):
    stored = json.loads((run / "results.json").read_text())["rows"][0]
    others = [stored | {"experiment": name} for name in ("zebra", "antelope")]
    change(run / "results.json", rows=[*others, stored, stored | {"platform": "bluebird"}])
    names = [row.name for row in read_run(run).results.rows]
    assert names[:2] == ["damped and stacked", "damped and stacked (bluebird)"]
    assert names[2:] == ["antelope, stacked", "zebra, stacked"]


def test_the_first_seed_is_the_lowest_of_the_very_row():
    """Not of the other way, nor of another simulator; 0 where no training is behind it."""
    several = [
        row(seed=7),
        row(seed=5),
        row(seed=4, stacking=False),
        row(seed=3, platform="bluebird"),
        row(seed=2, experiment="vertical"),
        row(seed=None),
    ]
    run = Run(Path("folder"), results(rows_by_seed=several), None)
    wanted = (several[0], several[2], several[3], row(experiment="do-nothing"))
    found = [run.evaluation(one).relative_to("folder/evaluation") for one in wanted]
    assert [folder.name for folder in found] == [
        "lateral-s5-skystack-stacked",
        "lateral-s4-skystack-plain",
        "lateral-s3-bluebird-stacked",
        "do-nothing-s0-skystack-stacked",
    ]


def test_a_row_is_found_by_experiment_and_way():
    both = [row(), row(stacking=False), row(experiment="vertical", stacking=False)]
    run = results(rows=both)
    assert run.row("lateral", True) is both[0]
    assert run.row("lateral", False) is both[1]
    assert run.row("vertical", True) is None


@pytest.mark.parametrize(
    ("experiment", "family"),
    [
        ("lateral", "lateral"),
        ("vertical-mine", "vertical"),
        ("avoidance-large", "avoidance"),
        ("do-nothing", "lateral"),
        ("my-vertical", "other"),
        ("verticals", "other"),
    ],
)
def test_without_a_task_the_family_is_the_first_word_if_that_is_a_task(experiment, family):
    assert row(experiment=experiment).family == family_of(experiment, None) == family


def test_a_family_is_the_task_that_a_row_states():
    assert row(experiment="lateral-mine", task="holding").family == "holding"
    assert family_title("holding") == "Holding"
    assert family_order(["zebra", "vertical", "lateral", "holding"]) == [
        *("lateral", "vertical", "holding", "zebra"),
    ]


def test_families_hold_their_rows_in_order_and_their_trained_experiments():
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


def test_names_of_a_row():
    own, other = row(), row(stacking=False, platform="bluesky", experiment="mine")
    assert (own.policy, own.name, own.title, own.slug) == (
        "damped and stacked",
        "damped and stacked",
        "Damped and stacked",
        "lateral-stacked",
    )
    assert (other.policy, other.name, other.title, other.slug) == (
        "mine, plain",
        "mine, plain (bluesky)",
        "Mine, plain (bluesky)",
        "mine-bluesky-plain",
    )


def test_the_bound_is_known_of_lateral_navigation_only():
    bound = Bound(1.6, 100)
    run = Run(Path(), results(), bound)
    assert run.bound_of("lateral") is bound
    assert run.bound_of("vertical") is run.bound_of("avoidance") is None


def test_rows_are_sorted_by_policy_then_simulator_then_name():
    wanted = [
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
    assert in_order(wanted[::-1]) == wanted


def test_readable_names_are_distinct():
    assert len(set(READABLE_NAMES.values())) == len(READABLE_NAMES)


def test_every_experiment_has_a_name_for_each_way():
    """Which says that it is stacked where it is."""
    assert {experiment for experiment, _ in READABLE_NAMES} == {*experiment_names(), "do-nothing"}
    for experiment in experiment_names():
        plain, stacked = (READABLE_NAMES[experiment, way] for way in (False, True))
        assert stacked.split()[-1] == "stacked"
        assert plain.split()[-1] != "stacked"
    assert ("do-nothing", True) not in READABLE_NAMES


ONE = Estimate(1.0, 0.0, 2.0)
NAME = RowName("lateral", True)


@pytest.mark.parametrize(
    "record",
    [
        *(row(), results(), training("lateral"), Bound(1.6, 2), Update(steps=1), Paper(7.2)),
        *(NAME, Difference(ONE, ONE), Comparison(NAME, NAME, {}), Statistics(ONE, ONE)),
    ],
)
def test_what_was_read_stays_as_it_is(record):
    with pytest.raises(AttributeError, match="immutable"):
        setattr(record, record.__struct_fields__[0], None)


def test_bound_is_optional(run):
    assert read_run(run).bound.clearances_mean == 1.6
    (run / "bound.json").unlink()
    assert read_run(run).bound is None


def test_updates_have_null_where_nothing_ended(run):
    whole = read_run(run)
    updates = whole.updates(whole.results.train[0])
    assert (updates[0].steps, updates[0].success) == (8192, None)
    assert 0.0 <= updates[-1].success <= 1.0


@pytest.mark.parametrize("name", ["results.json", "train/lateral-s0/metrics.jsonl"])
@pytest.mark.parametrize("content", [None, "", "{", '{"rows": 3, "steps": "many"}'])
def test_missing_and_damaged_files_are_named_in_one_line(run, name, content):
    path = run / name
    path.unlink() if content is None else path.write_text(content)

    def read():
        whole = read_run(run)
        whole.updates(whole.results.train[0])

    with pytest.raises(InputError, match=path.name) as error:
        read()
    assert "\n" not in str(error.value)


def test_a_damaged_line_is_named_by_its_number(run):
    path = run / "train" / "lateral-s0" / "metrics.jsonl"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], "{", *lines[2:]]))
    whole = read_run(run)
    with pytest.raises(InputError, match=r"metrics\.jsonl: line 3: damaged"):
        whole.updates(whole.results.train[0])


@pytest.mark.parametrize(("end", "kept"), [("", 1), ("\n", 1), ('\n{"upd', 1), ("\nx", 1)])
def test_a_last_line_that_was_half_written_does_not_count(end, kept, run):
    """As while a training goes on, or after it was killed."""
    path = run / "train" / "lateral-s0" / "metrics.jsonl"
    first = path.read_text().splitlines()[0]
    path.write_text(first + end)
    assert len(read_updates(path.parent)) == kept


def test_everything_is_sorted_as_it_is_read(run):
    """Rows, also those of simulators and of seeds, and trainings."""
    stored = json.loads((run / "results.json").read_text())
    one, train = stored["rows"][0], stored["train"][0]
    ways = [one | {"stacking": way, "platform": on} for way in (True, False) for on in SIMULATORS]
    seeds = [one | {"stacking": way, "seed": seed} for seed in (10, 2) for way in (True, False)]
    trained = [train | {"experiment": name, "seed": seed} for seed in (10, 2) for name in TRAINED]
    nobody = one | {"experiment": "do-nothing", "stacking": False}
    rows = [nobody, one, one | {"experiment": "lateral-undamped", "stacking": False}]
    change(run / "results.json", rows=rows, platforms=ways[::-1], rows_by_seed=seeds, train=trained)
    found = read_run(run).results
    assert [each.name for each in found.rows] == ["undamped", "damped and stacked", "do nothing"]
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
def test_a_name_cannot_lead_out_of_the_folder(run, name):
    row = json.loads((run / "results.json").read_text())["rows"][0]
    change(run / "results.json", rows=[row | {"experiment": name}])
    with pytest.raises(InputError, match=r"results\.json: damaged"):
        read_run(run)


@pytest.mark.parametrize("table", ["rows", "rows_by_seed", "train", "platforms"])
def test_what_stands_twice_is_refused(table, run):
    path = run / "results.json"
    stored = json.loads(path.read_text())
    stored["platforms"] = [stored["rows"][0] | {"platform": name} for name in SIMULATORS]
    path.write_text(json.dumps(stored))
    read_run(run)  # in several simulators it is not twice
    stored[table].insert(1, stored[table][0])
    path.write_text(json.dumps(stored))
    with pytest.raises(InputError, match=rf"{table}: .* occurs twice \(allowed: once\)"):
        read_run(run)
