"""`skystack evaluate` with files of other libraries, and functions in other simulators."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

import skystack
from skystack.agents.agent import Batched
from skystack.cli import main
from skystack.evaluation.agreement import same_clearances
from skystack.learning.experiment import Experiment
from skystack.tasks.settings import NavigationSettings

pytestmark = pytest.mark.usefixtures("one_process")

TABLES = ["aircraft", "clearances", "episodes", "trajectories"]


def evaluate(capsys, *words):
    """The exit code, the row and the output on standard error."""
    code = main(["evaluate", *(str(word) for word in words), "--json"])
    captured = capsys.readouterr()
    return code, json.loads(captured.out)["rows"][0] if captured.out else None, captured.err


@pytest.fixture(scope="module")
def onnx_file(tmp_path_factory):
    pytest.importorskip("onnxruntime")
    path = tmp_path_factory.mktemp("export") / "theirs.onnx"
    assert main(["export", "lateral-best", "--format", "onnx", "-o", str(path)]) == 0
    return path


@pytest.mark.slow
@pytest.mark.parametrize("stacking", ["--stacking", "--no-stacking"])
def test_an_onnx_file_gives_the_row_and_tables_of_the_policy(stacking, onnx_file, capsys, tmp_path):
    words = ["--episodes", 6, stacking, "--out", tmp_path]
    code, row, _ = evaluate(capsys, onnx_file, *words)
    assert code == 0
    _, ours, _ = evaluate(capsys, "lateral-best", *words)
    varying = {"experiment", "wall_s", "min_separation_nm_min", "min_separation_nm_mean"}
    assert row.keys() == ours.keys()
    # Positions that are computed in another program differ by rounding.
    offsets_nm = [each.pop("exit_offset_nm_mean") for each in (row, ours)]
    assert offsets_nm[0] == pytest.approx(offsets_nm[1], abs=1e-4)
    assert {name: row[name] for name in row.keys() - varying} == {
        name: ours[name] for name in row.keys() - varying
    }
    kind = "stacked" if stacking == "--stacking" else "plain"
    folder, other = (tmp_path / f"{name}-s0-skystack-{kind}" for name in ("theirs", "lateral-best"))
    assert sorted(path.stem for path in folder.glob("*.parquet")) == TABLES
    issued, expected = (pq.read_table(each / "clearances.parquet") for each in (folder, other))
    assert issued.equals(expected)
    page = tmp_path / "replay.html"
    assert main(["replay", str(folder), str(other), "-o", str(page)]) == 0
    assert page.stat().st_size > 10_000
    capsys.readouterr()


@pytest.mark.slow
def test_an_onnx_file_samples_the_same_as_the_policy(onnx_file, capsys):
    rows = [
        evaluate(capsys, name, "--episodes", 6, "--sample")[1]
        for name in (onnx_file, "lateral-best")
    ]
    assert rows[0]["instructions_mean"] == rows[1]["instructions_mean"]
    assert not rows[0]["greedy"]


@pytest.mark.slow
def test_evaluates_a_zip_on_the_given_experiment(capsys, tmp_path):
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    import gymnasium

    import skystack.gym  # noqa: F401  (registers the environments)

    environment = gymnasium.make("skystack/Lateral-v0")
    model = stable_baselines3.PPO("MlpPolicy", environment, device="cpu", seed=0)
    model.save(tmp_path / "model.zip")
    few = [tmp_path / "model.zip", "--episodes", 2]
    code, row, _ = evaluate(capsys, *few, "--experiment", "lateral", "--out", tmp_path / "e")
    assert (code, row["experiment"], row["episodes"]) == (0, "model", 2)
    assert [path.name for path in (tmp_path / "e").iterdir()] == ["model-s0-skystack-stacked"]
    for words, message in (
        ([], "model needs an experiment: none was given (allowed: --experiment NAME"),
        (["--experiment", "vertical"], "model has 8 observed values and 5 actions (allowed for ve"),
        (["--experiment", "lateral", "--sector", "merg"], "unknown sector 'merg'; did you mean"),
    ):
        code, _, err = evaluate(capsys, *few, *words)
        assert (code, err.count("\n")) == (2, 1)
        assert err.startswith(f"skystack: {message}")


def test_reports_mistakes_in_one_line(capsys, tmp_path):
    (tmp_path / "model.zip").write_bytes(b"no zip")
    for words, message in (
        (["lateral", "--experiment", "lateral"], "lateral already names its experiment"),
        ([tmp_path / "model.zip"], f"{tmp_path / 'model.zip'}: is not a zip"),
        ([tmp_path / "none.onnx"], f"{tmp_path / 'none.onnx'}: cannot be read"),
    ):
        code, row, err = evaluate(capsys, *words)
        assert (code, row, err.count("\n")) == (2, None, 1)
        assert err.startswith(f"skystack: {message}")


def turning(settings, until_deg):
    """A closure, pickled by value: turns AC1 left until its turn to the next fix is this large.

    `theta_f` is the turn to the next fix, -180 to 180 degrees as 0 to 1.
    """

    def turn(observation):
        return int(360.0 * observation[settings.features.index("theta_f")] - 180.0 < until_deg)

    return turn


@pytest.mark.slow
@pytest.mark.parametrize("stacking", [True, False])
def test_a_function_flies_in_bluebird(stacking, tmp_path):
    """The same clearances as in our simulator: left turns of AC1, in bursts."""
    pytest.importorskip("bluebird_dt")
    settings = NavigationSettings(features=("theta_f", "d_f"), cycles=100)
    experiment = Experiment("turning", task=settings)
    turn = turning(settings, until_deg=25.0)
    conditions = skystack.Conditions(episodes=2, stacking=stacking)
    here = skystack.evaluate(turn, conditions, tmp_path, experiment=experiment)
    many = Batched(
        lambda observations: np.array([turn(observation) for observation in observations])
    )
    for policy in (turn, many) if stacking else (turn,):
        there = skystack.evaluate(
            policy,
            conditions._replace(platform="bluebird"),
            tmp_path,
            experiment=experiment,
            name="there",
        )
        assert there.failed == {}
        assert all(same_clearances(here.clearances, there.clearances, range(2)))
    assert {path.name.split("-")[0] for path in tmp_path.iterdir()} == {"turn", "there"}
    if stacking:
        assert set(here.clearances["callsign"].to_pylist()) == {"AC1"}
        assert max(here.clearances["instructions"].to_pylist()) > 1


@pytest.mark.slow
def test_an_onnx_file_flies_in_bluebird(onnx_file):
    pytest.importorskip("bluebird_dt")
    agent = skystack.find_agent(str(onnx_file))
    here, there = (
        skystack.evaluate(agent, skystack.Conditions(episodes=2, platform=platform))
        for platform in ("skystack", "bluebird")
    )
    assert all(same_clearances(here.clearances, there.clearances, range(2)))
    assert there.row["success_rate"] == 1.0


@pytest.mark.slow
def test_reports_a_function_that_fails_in_bluebird():
    pytest.importorskip("bluebird_dt")
    calls = []

    def fails(observation):
        calls.append(observation)
        return 1 // (4 - len(calls))

    settings = NavigationSettings(cycles=100)
    with pytest.raises(
        skystack.InputError,
        match=r"^scenario \d, cycle \d: the policy failed: ZeroDivisionError: .*zero$",
    ):
        skystack.evaluate(
            fails,
            skystack.Conditions(episodes=2, platform="bluebird"),
            experiment=Experiment("short", task=settings),
        )
