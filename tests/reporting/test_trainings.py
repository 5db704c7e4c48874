"""Reading run folders: trainings and rows are found, missing and damaged files are named."""

import json

import pytest
from msgspec import to_builtins

from skystack.errors import InputError
from skystack.learning.experiment import load_experiment, to_toml
from skystack.reporting.trainings import differences, read_runs, short_names
from tests.reporting.rows import results, row, training

LINES = [
    {"update": n, "steps": 256 * n, "wall_s": 2.0 * n, "return": -1.0, "success": 0.75}
    | {"instructions": 12.0, "episodes": 3.0}
    for n in (1, 2, 3)
]


def write_training(folder, experiment="lateral", *changes, seed=None):
    folder.mkdir(parents=True)
    (folder / "config.toml").write_bytes(to_toml(load_experiment(experiment, changes)))
    (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in LINES))
    if seed is not None:
        (folder / "policy.json").write_text(json.dumps({"format": 1, "seed": seed}))
    return folder


def test_summarises_a_training(tmp_path):
    finished = write_training(tmp_path / "finished", "vertical", seed=3)
    interrupted = write_training(tmp_path / "interrupted")
    first, second = read_runs([finished, interrupted]).trainings
    assert first.summary == {
        "run": "finished",
        "experiment": "vertical",
        "seed": 3,
        "steps": 768,
        "wall_s": 6.0,
        "success": pytest.approx(0.75),
        "instructions": pytest.approx(12.0),
    }
    assert (first.family, first.curve) == ("vertical", "finished")
    assert (second.experiment, second.seed) == ("lateral", None)


def test_reads_the_trainings_and_rows_of_a_reproduction(written, tmp_path):
    alone = write_training(tmp_path / "alone")
    runs = read_runs([written, alone])
    found = [(each.run, each.experiment, each.seed) for each in runs.trainings]
    assert found == [
        ("run", experiment, seed)
        for experiment in ("lateral-undamped", "lateral")
        for seed in (0, 1)
    ] + [("alone", "lateral", None)]
    assert {each.curve for each in runs.trainings} == {
        "run, lateral-undamped",
        "run, lateral",
        "alone",
    }
    assert [each.row.name for each in runs.rows] == [
        "undamped",
        "damped",
        "damped and stacked",
        "do nothing",
    ]


def test_equal_rows_of_several_runs_are_adjacent(tmp_path):
    """Rows are in the order of the tables, equal rows in that of the folders. Seeds are those of
    the run, even if a policy file differs. The name of a single experiment is omitted."""
    folders = []
    for name, seed in (("b", 4), ("a", 5)):
        folder = tmp_path / name
        rows = [to_builtins(row(stacking=way)) for way in (True, False)]
        stored = to_builtins(results()) | {"rows": rows}
        stored["train"] = [to_builtins(training("lateral", seed))]
        write_training(folder / "train" / f"lateral-s{seed}", seed=9)
        (folder / "results.json").write_text(json.dumps(stored))
        folders.append(folder)
    runs = read_runs(folders)
    assert [(each.run, each.row.stacking) for each in runs.rows] == [
        ("b", False),
        ("a", False),
        ("b", True),
        ("a", True),
    ]
    assert [(each.curve, each.run, each.seed) for each in runs.trainings] == [
        ("b", "b", 4),
        ("a", "a", 5),
    ]


def test_names_are_as_short_as_possible(tmp_path):
    paths = [tmp_path / "a" / "s0", tmp_path / "b" / "s0", tmp_path / "b" / "s1"]
    assert short_names(paths) == ["a/s0", "b/s0", "s1"]
    assert short_names([tmp_path / "a", tmp_path / "b" / "a"]) == [f"{tmp_path.name}/a", "b/a"]
    with pytest.raises(InputError, match="given twice"):
        short_names([tmp_path / "a", tmp_path / "b" / ".." / "a"])


def test_lists_differing_settings_by_key(tmp_path):
    folders = [
        write_training(tmp_path / "a"),
        write_training(tmp_path / "b", "lateral", "ppo.gamma=0.9", "pretraining.steps=512"),
    ]
    settings = {each.run: each.settings for each in read_runs(folders).trainings}
    found = differences(settings)
    gamma, steps = found.pop("ppo.gamma"), found.pop("pretraining.steps")
    assert (gamma, steps) == ({"a": 0.99, "b": 0.9}, {"a": None, "b": 512})
    assert all(key.startswith("pretraining.reward.") for key in found)
    renamed = settings["a"] | {"name": "other", "description": "..."}
    assert differences({"a": settings["a"], "c": renamed}) == {}
    assert differences({"a": {"x": 1}, "b": {"x": 1}, "c": {"x": 2}}) == {
        "x": {"a": 1, "b": 1, "c": 2}
    }


@pytest.mark.parametrize(
    ("name", "contents", "message"),
    [
        ("config.toml", None, "config.toml: cannot be read"),
        ("config.toml", b"name = ", "config.toml: damaged"),
        ("config.toml", b"\xff", "config.toml: damaged"),
        ("config.toml", b"name = '../x'", "name is .* .allowed: 1 to 80 of A-Z, a-z"),
        ("config.toml", b"name = 3", "config.toml: damaged: name is 3"),
        ("config.toml", b"#" * 10_000_001, "config.toml: is too large .allowed: 10 MB"),
        ("metrics.jsonl", b"", "metrics.jsonl: contains no complete line"),
        ("metrics.jsonl", b'{"steps": 1}\n{"st\n', "metrics.jsonl: line 2: damaged"),
        ("metrics.jsonl", None, "not a run folder"),
        ("policy.json", b"{}", "policy.json: damaged"),
        ("results.json", b"{}", "results.json: damaged"),
    ],
)
def test_names_missing_and_damaged_files(tmp_path, name, contents, message):
    folder = write_training(tmp_path / "run", seed=0)
    if contents is None:
        (folder / name).unlink()
    else:
        (folder / name).write_bytes(contents)
    with pytest.raises(InputError, match=message) as error:
        read_runs([folder])
    assert "\n" not in str(error.value)
