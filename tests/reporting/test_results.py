"""Reading `results.json`, `bound.json` and `metrics.jsonl`."""

import json

import pytest

from skystack.errors import InputError
from skystack.reporting.results import READABLE_NAMES, Run, read_run


def change(path, **values):
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def test_rows_come_in_the_order_of_the_paper_whatever_the_file_says(reported):
    names = [row.name for row in read_run(reported).results.rows]
    assert names == ["undamped", "damped", "damped and stacked", "do nothing"]


def test_unknown_experiments_follow_by_name(run):
    stored = json.loads((run / "results.json").read_text())["rows"][0]
    others = [stored | {"experiment": name} for name in ("zebra", "antelope")]
    change(run / "results.json", rows=[*others, stored, stored | {"platform": "bluebird"}])
    names = [row.name for row in read_run(run).results.rows]
    assert names[:2] == ["damped and stacked", "damped and stacked (bluebird)"]
    assert names[2:] == ["antelope, stacked", "zebra, stacked"]


def test_first_seed_is_the_lowest_of_the_same_row(reported):
    whole = read_run(reported)
    row = whole.results.rows[1]
    assert whole.first_seed(row) == 0
    later = [one for one in whole.results.rows_by_seed if one.seed == 1]
    changed = Run(whole.folder, whole.results.__class__(**vars_of(whole, later)), None)
    assert changed.evaluation(row).name == "lateral-s1-skystack-plain"


def vars_of(whole, rows_by_seed):
    fields = {name: getattr(whole.results, name) for name in whole.results.__struct_fields__}
    return fields | {"rows_by_seed": rows_by_seed}


def test_readable_names_are_distinct():
    assert len(set(READABLE_NAMES.values())) == len(READABLE_NAMES)


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


@pytest.mark.parametrize("name", ["../elsewhere", "a/b", "..", "", "a\n", ".hidden"])
def test_a_name_cannot_lead_out_of_the_folder(run, name):
    row = json.loads((run / "results.json").read_text())["rows"][0]
    change(run / "results.json", rows=[row | {"experiment": name}])
    with pytest.raises(InputError, match=r"results\.json: damaged"):
        read_run(run)


@pytest.mark.parametrize("table", ["rows", "rows_by_seed", "train"])
def test_what_stands_twice_is_refused(table, run):
    path = run / "results.json"
    results = json.loads(path.read_text())
    results[table].append(results[table][0])
    path.write_text(json.dumps(results))
    with pytest.raises(InputError, match=rf"{table}: .* stands in it twice \(allowed: once\)"):
        read_run(run)
