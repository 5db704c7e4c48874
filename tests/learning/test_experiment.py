"""Experiments: the shipped ones, changes to them, and rejected files."""

import tomllib
from pathlib import Path

import pytest
from msgspec.structs import replace

from skystack.airspace.sector_file import SectorEntry
from skystack.errors import InputError
from skystack.learning.experiment import experiment_names, load_experiment, to_toml
from skystack.tasks.registry import build_task
from skystack.tasks.settings import PAPER_FEATURES

LATERAL = load_experiment("lateral")


@pytest.mark.parametrize("name", experiment_names())
def test_shipped_experiments_load_by_name(name):
    experiment = load_experiment(name)
    assert experiment.name == name
    assert experiment.description


# Reward weights in the paper's table: centreline, damping, safety, vertical, terminal.
PAPER = {
    "lateral-undamped": (1.0, 0.0, 0.0, 0.0, 1.0),
    "lateral": (1.0, 0.25, 0.0, 0.0, 1.0),
    "lateral-large": (1.0, 0.25, 0.0, 0.0, 1.0),
    "vertical": (0.0, 0.5, 0.0, 1.0, 1.0),
    "avoidance": (1.0, 0.3, 2.0, 0.0, 1.0),
    "avoidance-large": (1.0, 0.3, 2.0, 0.0, 1.0),
}


def reward_weights(reward):
    names = ("centreline", "damping", "safety", "vertical", "terminal")
    return tuple(getattr(reward, name) for name in names)


@pytest.mark.parametrize("name", PAPER)
def test_paper_experiments_have_the_papers_training_settings(name):
    experiment = load_experiment(name)
    ppo, reward = experiment.ppo, experiment.task.reward
    assert (ppo.learning_rate, ppo.gamma, ppo.entropy) == (1e-4, 0.99, 0.01)
    assert ppo.final_learning_rate == 1.0
    assert ppo.hidden == (64, 64)
    assert reward_weights(reward) == PAPER[name]
    assert reward.count_criterion == (name != "lateral-undamped")
    extensions = (reward.burst, reward.outside_band, reward.excursion, reward.conflict)
    assert extensions == (0.0, 0.0, 0.0, 0.0)
    assert experiment.task.timing == "cycle"
    assert experiment.task.cycles == 300


@pytest.mark.parametrize("name", ["avoidance", "avoidance-large"])
def test_avoidance_has_the_papers_curriculum_and_features(name):
    """2 million steps without the safety reward, then 30 million with it."""
    experiment = load_experiment(name)
    task, pretraining = experiment.task, experiment.pretraining
    assert (pretraining.steps, experiment.ppo.total_steps) == (2_000_000, 32_000_000)
    assert reward_weights(pretraining.reward) == (1.0, 0.3, 0.0, 0.0, 1.0)
    assert (task.features, task.pair_features) == (PAPER_FEATURES, ("theta", "d"))
    assert (task.aircraft, task.level_fl, task.disc_nm) == (2, 300, 4.0)
    assert task.actions == ("large" if name == "avoidance-large" else "small")


def test_vertical_has_the_papers_settings():
    experiment = load_experiment("vertical")
    task = experiment.task
    assert (task.aircraft, task.levels_fl, task.actions) == (1, (100, 300), "levels")
    assert task.features == ("d_xfl", "fl_sx", "fl_nx", "delta_t_10")
    assert experiment.ppo.total_steps == 2_000_000
    assert experiment.pretraining is None


@pytest.mark.parametrize("name", ["lateral", "lateral-undamped", "lateral-large"])
def test_lateral_experiments_have_the_papers_settings(name):
    experiment = load_experiment(name)
    ppo, task = experiment.ppo, experiment.task
    assert ppo.total_steps == 2_000_000
    assert (task.aircraft, task.level_fl, task.disc_nm, task.cycles) == (2, 300, 4.0, 300)
    assert (task.features, task.timing) == (PAPER_FEATURES, "cycle")
    assert task.actions == ("large" if name == "lateral-large" else "small")
    assert experiment.pretraining is None


def test_changes_are_parsed_as_toml():
    experiment = load_experiment(
        "lateral", ["ppo.total_steps=500000", "ppo.learning_rate=3e-4", "task.actions=large"]
    )
    assert experiment.ppo.total_steps == 500_000
    assert experiment.ppo.learning_rate == 3e-4
    assert experiment.task.actions == "large"


def test_accepts_floats_with_integral_values_as_integers(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\n[task]\nlevel_fl = [300.0, 3.2e2]\ncycles = 4e2\n')
    changes = ["ppo.total_steps=5e5", "ppo.hidden=[32.0, 32]", "ppo.steps=64.0"]
    experiment = load_experiment(str(path), changes)
    assert (experiment.task.level_fl, experiment.task.cycles) == ((300, 320), 400)
    ppo = experiment.ppo
    assert (ppo.total_steps, ppo.hidden, ppo.steps) == (500_000, (32, 32), 64)
    assert {type(value) for value in (*experiment.task.level_fl, *ppo.hidden, ppo.steps)} == {int}
    assert type(load_experiment("lateral", ["ppo.gamma=1"]).ppo.gamma) is float


def test_resolved_experiment_loads_unchanged(tmp_path):
    path = tmp_path / "mine.toml"
    experiment = load_experiment("lateral", ["ppo.gamma=0.95"])
    path.write_bytes(to_toml(experiment))
    assert load_experiment(str(path)) == experiment
    assert tomllib.loads(path.read_text())["ppo"]["entropy"] == 0.01


STEPS = r".allowed: whole number from 1 to 10,000,000,000.$"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("ppo.learning_rat=1", r"ppo\.learning_rat.*did you mean 'ppo\.learning_rate'"),
        ("pop.gamma=1", r"'pop'.*did you mean 'ppo'"),
        ("ppo=3", "ppo is a value"),
        ("ppo.gamma=1.5", r"ppo\.gamma.*1"),
        ("ppo.total_steps=0", r"ppo\.total_steps"),
        ("ppo.total_steps=-5", r"ppo\.total_steps"),
        (
            "ppo.total_steps=many",
            rf'^--set: ppo.total_steps is "many" {STEPS}',
        ),
        (
            "ppo.total_steps=220.5",
            rf"ppo.total_steps is 220.5 {STEPS}",
        ),
        (
            "ppo.total_steps='220'",
            rf'ppo.total_steps is "220" {STEPS}',
        ),
        (
            "ppo.total_steps=1e300",
            rf"ppo.total_steps is 1e.300 {STEPS}",
        ),
        (
            "ppo.total_steps=true",
            rf"ppo.total_steps is true {STEPS}",
        ),
        ("task.fleet=[{shar=1}]", r"task.fleet.0.: unknown field 'shar'; did you mean 'share'"),
        ("task.cycles=10001", r"task.cycles is 10001 .allowed: whole number from 1 to 10,000"),
        ("ppo.gamma=nan", r"ppo\.gamma"),
        ("ppo.learning_rate=inf", r"ppo\.learning_rate"),
        ("task.reward.damping=nan", r"task\.reward\.damping"),
        ("ppo.minibatch=100000", r"ppo\.minibatch"),
        ("task.actions=huge", r'task.actions is "huge" .allowed: large, levels, small'),
        ("gamma", "key=value"),
        ("name.first=1", "value, not a table"),
    ],
)
def test_rejects_wrong_changes_in_one_line(change, message):
    with pytest.raises(InputError, match=message) as error:
        load_experiment("lateral", [change])
    assert "\n" not in str(error.value)


def test_suggests_the_nearest_experiment():
    with pytest.raises(InputError, match="did you mean 'lateral-large'"):
        load_experiment("lateral-lrage")


def test_rejects_unreadable_and_malformed_files(tmp_path):
    path = tmp_path / "broken.toml"
    path.write_text("name = ")
    with pytest.raises(InputError, match=r"broken.toml: is not TOML \("):
        load_experiment(str(path))
    path.write_bytes(b"name = '\xff'")
    with pytest.raises(InputError, match=r"broken.toml: is not UTF-8 \(byte 8\)"):
        load_experiment(str(path))
    with pytest.raises(InputError, match="cannot be read"):
        load_experiment(str(tmp_path / "missing.toml"))


OWN_SECTOR = Path(__file__).parents[2] / "examples" / "own-sector"


def test_experiment_includes_its_sector_file(tmp_path):
    """The sector's path is relative to the experiment's folder; later the file is not needed."""
    experiment = load_experiment(str(OWN_SECTOR / "valley.toml"))
    assert build_task(experiment.task).simulator.sector.name == "valley"
    path = tmp_path / "alone.toml"
    path.write_bytes(to_toml(experiment))
    assert load_experiment(str(path)) == experiment


def test_sector_on_the_command_line_is_relative_to_cwd(monkeypatch):
    monkeypatch.chdir(OWN_SECTOR)
    experiment = load_experiment("lateral", ["task.sector=valley.json"])
    assert experiment.task == replace(LATERAL.task, sector=experiment.task.sector)
    assert isinstance(experiment.task.sector, SectorEntry)
    assert load_experiment("lateral", ["task.sector=merge"]).task.sector == "merge"


def test_experiment_cannot_read_files_outside_its_folder(tmp_path):
    (tmp_path / "inner").mkdir()
    for file in OWN_SECTOR.glob("valley.*"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "inner" / "lateral.toml"
    for sector in ("../valley.json", str(tmp_path / "valley.json"), "a/../../valley.json"):
        path.write_text(f'name = "lateral"\n[task]\nsector = "{sector}"\n')
        with pytest.raises(InputError, match=r"task\.sector: is not allowed"):
            load_experiment(str(path))
    # On the command line, any path is allowed.
    experiment = load_experiment("lateral", [f"task.sector={tmp_path / 'valley.json'}"])
    assert isinstance(experiment.task.sector, SectorEntry)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("task.sector=merg", "task.sector: unknown sector 'merg'; did you mean 'merge'?"),
        ("task.sector=merg.json", "task.sector: merg.json: cannot be read"),
        ("task.sector.name=x", "--set: task.sector"),
    ],
)
def test_rejects_an_unknown_sector(change, message):
    with pytest.raises(InputError) as error:
        load_experiment("lateral", [change])
    assert str(error.value).startswith(message)


def test_rejects_more_aircraft_than_first_fixes():
    with pytest.raises(InputError, match="each needs its own first fix and merge has 3"):
        load_experiment("lateral", ["task.sector=merge", "task.aircraft=4"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            "ppo.totl_steps=3",
            "--set: unknown key 'ppo.totl_steps'; did you mean 'ppo.tot",
        ),
        ("total_steps=3", "--set: unknown key 'total_steps'; did you mean 'ppo.total_steps'?"),
        (
            "ppo.total_steps=a",
            '--set: ppo.total_steps is "a" (allowed: whole number from 1 to 10,000,000,000)',
        ),
    ],
)
def test_attributes_errors_to_the_change_or_the_file(change, message, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"')
    with pytest.raises(InputError) as error:
        load_experiment(str(path), [change])
    assert str(error.value).startswith(message)
    path.write_text('name = "mine"\nppo.total_steps = "b"')
    with pytest.raises(InputError) as error:
        load_experiment(str(path), ["ppo.steps=3"])
    assert str(error.value).startswith(f'{path}: ppo.total_steps is "b" (allowed: whole')


def test_suggests_a_file_of_that_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text('name = "mine"')
    with pytest.raises(InputError, match=r"unknown experiment 'mine'; did you mean 'mine.toml'\?"):
        load_experiment("mine")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[ppo]\ngamma = nan", r"ppo.gamma is NaN \(allowed: finite number\)"),
        ("[ppo]\nsteps = " + "1" * 5000, "has a whole number with too many digits"),
        ("name = " + "[" * 5000, "is nested too deep .allowed: 32 levels"),
        ("name = 1979-05-27", "name is 1979-05-27 .allowed: no dates"),
    ],
)
def test_rejects_toml_that_a_parser_accepts_or_fails_on(tmp_path, text, message):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        load_experiment(str(path))


def test_skips_a_byte_order_mark(tmp_path):
    """Some editors write one; JSON files may have one, too."""
    path = tmp_path / "marked.toml"
    path.write_bytes(b"\xef\xbb\xbf" + to_toml(LATERAL))
    assert load_experiment(path) == LATERAL


@pytest.mark.parametrize("text", ["a\nppo.steps = 3", "\udcff", "a\x1b[31m"])
def test_change_must_be_one_printable_line(text):
    """Further lines would be ignored, and bytes that are not UTF-8 are not text."""
    with pytest.raises(InputError, match=r"^--set .* is not one printable line$"):
        load_experiment("lateral", [f"description={text}"])


def test_keys_of_older_versions_load(tmp_path):
    """`stray` was renamed to `excursion`, in both reward tables; both at once are rejected."""
    path = tmp_path / "old.toml"
    path.write_text(
        'name = "old"\n[task.reward]\nstray = 10.0\n[pretraining]\nsteps = 5\n'
        "[pretraining.reward]\nstray = 3.0\n"
    )
    experiment = load_experiment(path)
    assert experiment.task.reward.excursion == 10.0
    assert experiment.pretraining.reward.excursion == 3.0
    assert b"stray" not in to_toml(experiment)
    with pytest.raises(InputError, match=r"unknown key 'task.reward.stray'"):
        load_experiment(path, ["task.reward.excursion=1.0"])
