"""Pieces of work, tables, and the page that describes the methods."""

import re
import sys
from pathlib import Path

import pytest

from skystack.reporting.tables import NOTHING
from studies.neighbours import __main__ as command
from studies.neighbours import compare
from studies.neighbours.learner import Budget
from studies.neighbours.methods import ALONE, METHODS, PROBLEMS, STACKING, experiment_of

ROOT = Path(__file__).parents[3]


def row(mean, success=1.0, losses=0.0):
    return {
        "clearances_mean": mean,
        "clearances_std": 2.0,
        "success_rate": success,
        "losses": losses,
    }


def result(mean, to_good=100_000, ways=ALONE, **values):
    rows = {way.name: row(mean + number, **values) for number, way in enumerate(ways)}
    return {"cycles_to_good": to_good, "train_s": 10.0, **rows}


def cells(table):
    return {line[0]: line[1:] for line in table.rows}


def test_the_table_has_a_row_for_each_method_and_two_for_stacking():
    results = {
        ("lateral", "small changes"): [result(20.0, ways=STACKING), result(22.0, ways=STACKING)],
        ("lateral", "FiGAR"): [result(5.0, None), result(6.0, success=0.5, losses=3.0)],
        ("vertical", "FiGAR"): [result(1.0)],
    }
    found = cells(compare.table("lateral", results))
    always = ("2 of 2", "100.0 % (100.0 %)", "0.0", "100 k", "10 s")
    assert found == {
        "small changes": ("21.0 (20.0 to 22.0)", *always),
        "stacking (the paper)": ("23.0 (22.0 to 24.0)", *always),
        "FiGAR": ("5.0 (5.0 to 5.0)", "1 of 2", "75.0 % (50.0 %)", "1.5", NOTHING, "10 s"),
    }
    stacking = compare.stacking_table("lateral", results)
    assert [line[1] for line in stacking.rows] == [way.name for way in STACKING]
    assert [line[2][:4] for line in stacking.rows] == ["21.0", "22.0", "23.0", "24.0", "25.0"]
    assert compare.stacking_table("vertical", results).rows == ()


def test_every_piece_is_done_once_seed_by_seed(monkeypatch, tmp_path):
    done = []

    def run_pieces(work, pieces, what):
        done.extend(pieces)
        return [{"seed": seed} for _, _, seed, _ in pieces]

    monkeypatch.setattr(compare, "run_pieces", run_pieces)
    results = compare.run(list(PROBLEMS), list(METHODS), 2, tmp_path)
    assert len(set(done)) == len(done) == 2 * (3 * len(METHODS) - 1)
    assert [seed for _, _, seed, _ in done] == sorted(seed for _, _, seed, _ in done)
    assert ("vertical", "absolute 5") not in results  # levels are multiples of ten
    assert all(found == [{"seed": 0}, {"seed": 1}] for found in results.values())


@pytest.mark.slow
@pytest.mark.parametrize("method", ["frozen time", "FiGAR", "TempoRL (DQN)"])
def test_trains_and_flies_and_reuses_the_result(method, monkeypatch, tmp_path):
    monkeypatch.setattr(compare, "SCENARIOS", 3)
    short = PROBLEMS["vertical"]._replace(cycles=5000)
    monkeypatch.setitem(PROBLEMS, "vertical", short)
    found = compare.measure("vertical", method, 1, tmp_path)
    assert set(found) == {"cycles_to_good", "train_s", *(way.name for way in METHODS[method].ways)}
    for way in METHODS[method].ways:
        assert 0.0 <= found[way.name]["success_rate"] <= 1.0
        assert found[way.name]["losses"] == 0.0  # one aircraft
    monkeypatch.setattr(compare, "fly", None)
    assert compare.measure("vertical", method, 1, tmp_path) == found


def test_records_when_enough_scenarios_reach_80_percent():
    budget = Budget()
    budget.add({"episodes": 0.0, "cycles": float("nan"), "correct_exit": float("nan")})
    assert budget.cycles == 0.0
    budget.add({"episodes": 60.0, "cycles": 100.0, "correct_exit": 1.0})
    assert (budget.cycles, budget.good_after) == (6000.0, None)
    budget.add({"episodes": 60.0, "cycles": 100.0, "correct_exit": 0.5})
    assert budget.good_after is None  # 75 % of 120
    budget.add({"episodes": 100.0, "cycles": 50.0, "correct_exit": 0.8})
    assert budget.good_after == 17_000
    budget.add({"episodes": 100.0, "cycles": 50.0, "correct_exit": 1.0})
    assert budget.good_after == 17_000


def test_budget_counts_steps_in_frozen_time():
    budget = Budget(steps=8192)
    budget.add({"episodes": 0.0, "cycles": float("nan"), "correct_exit": float("nan")})
    budget.add({"episodes": 100.0, "cycles": 10.0, "correct_exit": 0.9})
    assert (budget.cycles, budget.good_after) == (16384, 16384)


def test_the_page_describes_every_method():
    text = (ROOT / "docs/neighbours.md").read_text()
    described = dict(re.findall(r"^\| ([^|]+?) +\| ([^|]+\| [^|]+?) +\|$", text, re.MULTILINE))
    for name, method in METHODS.items():
        decision, expresses = (part.strip() for part in described[name].split("|"))
        assert (decision, expresses) == (method.decision, method.expresses)


@pytest.mark.parametrize("problem", PROBLEMS)
def test_updates_of_all_methods_have_equal_nominal_cycles_and_gradient_steps(problem):
    for method in METHODS.values():
        settings = experiment_of(PROBLEMS[problem], method).ppo
        cycles = settings.samples * method.cycles
        assert cycles == pytest.approx(8192, rel=0.1)
        assert settings.samples // settings.minibatch == pytest.approx(32, abs=2)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["latral"], "unknown problem 'latral'; did you mean 'lateral'?"),
        (["--method", "figar"], "unknown method 'figar'"),
        (["vertical", "--method", "absolute 5"], "unknown method for vertical 'absolute 5'"),
        (["--seeds", "0"], "--seeds is 0 (allowed: whole numbers from 1)"),
    ],
)
def test_refuses_bad_arguments_before_training(words, message, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["neighbours", *words])
    monkeypatch.setattr(command, "run", None)
    assert command.main() == 2
    assert capsys.readouterr().err.startswith(message)
