"""Rows of the comparison, from hand-made episodes, and the paper's figures."""

import math
import statistics

import pyarrow as pa
import pytest

from skystack.evaluation.paper import SCENARIOS, paper_row
from skystack.evaluation.summary import aggregate, summarise

EPISODES = {
    "clearances": [2, 4, 4, 5, 10],
    "instructions": [20, 30, 40, 50, 60],
    "success": [True, True, True, True, False],
    "correct_exit": [True, True, True, False, False],
    "excursion": [True, True, False, False, False],
    "few_clearances": [True, False, False, False, False],
    "loss_of_separation": [True, False, True, False, True],
    "min_separation_nm": [3.0, 7.5, math.inf, 4.5, math.inf],
    "exits": [2, 1, 2, 0, 1],
    "exit_offset_nm": [1.0, 4.0, 2.0, None, 8.0],
}


def row_of(episodes, name="lateral", stacking=True):
    return summarise(name, "lateral", 3, "bluesky", stacking, False, 12.5, pa.table(episodes))


def test_a_row_summarises_its_episodes():
    """The standard deviation is that of these scenarios, without Bessel's correction."""
    row = row_of(EPISODES)
    assert row == {
        "seed": 3,
        "experiment": "lateral",
        "task": "lateral",
        "seeds": 1,
        "platform": "bluesky",
        "stacking": True,
        "greedy": False,
        "episodes": 5,
        "clearances_mean": pytest.approx(5.0),
        "clearances_std": pytest.approx(statistics.pstdev(EPISODES["clearances"])),
        "instructions_mean": pytest.approx(40.0),
        "success_rate": pytest.approx(0.8),
        "correct_exit_rate": pytest.approx(0.6),
        "excursion_rate": pytest.approx(0.4),
        "few_clearances_rate": pytest.approx(0.2),
        "loss_of_separation_count": 3,
        "min_separation_nm_min": 3.0,
        "min_separation_nm_mean": 5.0,
        "exit_offset_nm_mean": pytest.approx(3.0),  # (2 * 1 + 4 + 2 * 2 + 8) / 6
        "paper": None,
        "wall_s": 12.5,
    }


def test_separation_is_none_if_all_distances_are_infinite():
    row = row_of(EPISODES | {"min_separation_nm": [math.inf] * 5})
    assert (row["min_separation_nm_min"], row["min_separation_nm_mean"]) == (None, None)


def test_aggregate_pools_the_episodes_of_all_seeds():
    """The numbers of episodes differ, so that a mean of means would be wrong."""
    few = {name: values[:2] for name, values in EPISODES.items()}
    paper = {"clearances_mean": 14.5, "clearances_std": 6.6}
    rows = [row_of(each, stacking=False) | {"paper": paper} for each in (EPISODES, few)]
    rows[1] |= {"wall_s": 2.0}
    row = aggregate(rows, [pa.table(EPISODES), pa.table(few)])
    both = EPISODES["clearances"] + few["clearances"]
    assert "seed" not in row
    assert (row["seeds"], row["episodes"], row["wall_s"]) == (2, 7, 14.5)
    assert row["clearances_mean"] == pytest.approx(statistics.mean(both))
    assert row["clearances_std"] == pytest.approx(statistics.pstdev(both))
    assert row["success_rate"] == pytest.approx(6 / 7)
    assert row["loss_of_separation_count"] == 4
    assert row["min_separation_nm_mean"] == pytest.approx(25.5 / 5)
    names = ("experiment", "platform", "stacking", "greedy")
    assert [row[name] for name in names] == ["lateral", "bluesky", False, False]
    assert row["paper"] == paper
    # (2 * 1 + 4 + 2 * 2 + 8 + 2 * 1 + 4) / 9
    assert row["exit_offset_nm_mean"] == pytest.approx(24.0 / 9)


REPORTED = {
    ("lateral-undamped", False): (113.0, 15.9),
    ("lateral", False): (14.5, 6.6),
    ("lateral", True): (7.2, 3.5),
    ("lateral-large", False): (6.3, 3.0),
    ("avoidance", True): (81.2, 13.2),
    ("avoidance-large", False): (126.3, 12.3),
}
"""Section "Results and Discussion" of the paper."""
NAMES = ["lateral-undamped", "lateral", "lateral-large", "lateral-best", "vertical", "avoidance"]


@pytest.mark.parametrize("stacking", [False, True])
@pytest.mark.parametrize("name", [*NAMES, "avoidance-large"])
def test_only_rows_reported_in_the_paper_have_its_figures(name, stacking):
    mean, std = REPORTED.get((name, stacking), (None, None))
    expected = None if mean is None else {"clearances_mean": mean, "clearances_std": std}
    assert paper_row(name, stacking) == paper_row(f"{name}-tuned", stacking) == expected


def test_the_paper_evaluates_100_scenarios():
    assert SCENARIOS == 100
