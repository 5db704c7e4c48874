"""Readings of the paper: their settings, their distance from it, and their table."""

import math
from pathlib import Path

import pytest

from skystack.errors import InputError
from skystack.learning.experiment import load_experiment
from studies import readings
from studies.readings import AVOIDANCE, FACTORS, LATERAL, READINGS, WAYS, variant


@pytest.mark.parametrize("experiment", [*LATERAL, *AVOIDANCE])
@pytest.mark.parametrize("factor", FACTORS)
def test_a_factor_changes_settings_exactly_if_it_is_in_the_name(factor, experiment):
    original, changed = load_experiment(experiment), variant(experiment, (factor,))
    same = (changed.task, changed.ppo) == (original.task, original.ppo)
    assert changed.name == (experiment if same else f"{experiment}.{factor}")
    assert not same or (experiment == "lateral-undamped" and not FACTORS[factor].changes)


def test_damping_is_paid_as_the_factors_say():
    """The paper's weights are 0.25 and 0.3, and the mean over two aircraft is half of their sum."""

    def weights(experiment, factor):
        reward = variant(experiment, (factor,)).task.reward
        return reward.centreline, reward.damping, reward.shared_damping

    assert weights("lateral", "in-full") == (1.0, 0.5, 0.0)
    assert weights("lateral", "shared-counter") == (1.0, 0.0, 0.25)
    assert weights("lateral", "sum") == (2.0, 0.5, 0.0)
    assert weights("avoidance", "shared-counter") == (1.0, 0.0, 0.3)
    assert weights("lateral-undamped", "sum") == (2.0, 0.0, 0.0)
    first = variant("avoidance", ("in-full",)).pretraining.reward
    assert (first.damping, first.safety) == (0.6, 0.0)


def test_distance_is_the_mean_logarithm_of_the_ratios():
    paper = (10.0, 4.0)
    assert readings.distance([(paper, paper)]) == 0.0
    assert readings.distance([((20.0, 2.0), paper)]) == pytest.approx(math.log(2.0))
    assert readings.distance([((20.0, 4.0), paper), (paper, paper)]) == pytest.approx(
        math.log(2.0) / 4.0
    )
    nothing = readings.distance([((0.0, 0.0), (1.0, 1.0))])
    assert nothing == pytest.approx(math.log(10.0))  # 0.1 is the least value


def rows_of(mean, success=1.0):
    return [{"clearances_mean": mean, "clearances_std": 5.0, "success_rate": success} for _ in WAYS]


def test_the_nearest_reading_comes_first_and_shares_unaffected_policies():
    two = [(), ("in-full",)]
    names = {variant(each, reading).name for each in LATERAL for reading in two}
    assert len(names) == 5  # the undamped policy is the same
    found = {(name, seed): rows_of(100.0) for name in names for seed in range(2)}
    found["lateral.in-full", 0] = rows_of(10.0, success=0.5)
    found["lateral.in-full", 1] = rows_of(12.0)
    ranked = readings.scores(two, LATERAL, 2, found)
    assert [each.reading for each in ranked] == ["in-full", "in-full", "ours", "ours"]
    lines = readings.table(ranked, LATERAL).splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert cells[2][3:7] == ["113.0 ± 15.9", "14.5 ± 6.6", "7.2 ± 3.5", "6.3 ± 3.0"]
    assert cells[3][3:] == ["100.0 ± 5.0", "11.0 ± 5.0", "11.0 ± 5.0", "100.0 ± 5.0", "50.0 %"]


def test_every_training_is_done_once_and_seeds_are_in_order(monkeypatch, tmp_path):
    pieces = []

    def run_pieces(measure, planned, what):
        pieces.extend((experiment.name, seed) for experiment, seed, _ in planned)
        return [[experiment.name] for experiment, _, _ in planned]

    monkeypatch.setattr(readings, "run_pieces", run_pieces)
    trained = readings.variants(READINGS, LATERAL)
    found = readings.run(trained.values(), 2, tmp_path)
    assert len(set(pieces)) == len(pieces)
    assert [seed for _, seed in pieces] == sorted(seed for _, seed in pieces)
    assert {name for name, _ in pieces} == {
        variant(each, reading).name for each in LATERAL for reading in READINGS
    }
    assert found == {(name, seed): [name] for name, seed in pieces}


@pytest.mark.slow
def test_trains_and_evaluates_in_all_ways_and_reuses_the_rows(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(readings, "EPISODES", 2)
    small = load_experiment(
        "lateral",
        ["ppo.total_steps=256", "ppo.environments=4", "ppo.steps=64", "ppo.epochs=1"],
    )
    rows = readings.measure(small, 3, tmp_path)
    assert [(row["stacking"], row["greedy"]) for row in rows] == [tuple(way) for way in WAYS]
    assert {row["episodes"] for row in rows} == {2}
    monkeypatch.setattr(readings, "evaluate", None)
    assert readings.measure(small, 3, tmp_path) == rows


def test_refuses_an_unknown_factor():
    with pytest.raises(InputError, match="did you mean 'constant'"):
        readings._chosen(["sb3+constnat"])
    assert readings._chosen(["ours", "sb3+constant"]) == [(), ("sb3", "constant")]
    assert readings._chosen([]) == list(READINGS)
