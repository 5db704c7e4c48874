"""The paper's own figures pass its claims; figures that contradict them do not."""

import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skystack.evaluation.statistics import MEASURES, Estimate
from skystack.reporting.claims import CHANGED, MISSED, REPRODUCED, claims_table, judge_claims
from skystack.reporting.results import (
    Comparison,
    Difference,
    Results,
    Row,
    RowName,
    Run,
    Statistics,
    Training,
)

PAPER = {
    ("lateral-undamped", False): {"clearances": 113.0, "instructions": 113.0},
    ("lateral-undamped", True): {"clearances": 110.0},
    ("lateral", False): {"clearances": 14.5, "instructions": 14.5},
    ("lateral", True): {"clearances": 7.2},
    ("lateral-large", False): {"clearances": 6.3},
    ("avoidance", True): {"clearances": 81.2, "loss_of_separation": 0.01},
    ("avoidance-large", False): {"clearances": 126.3, "loss_of_separation": 0.09},
}


def row(experiment, stacking, figures):
    values = dict.fromkeys(MEASURES, 1.0) | figures
    statistics = {
        name: Statistics(Estimate(value, value, value), Estimate(value, value, value))
        for name, value in values.items()
    }
    return Row(
        experiment=experiment,
        platform="skystack",
        stacking=stacking,
        seeds=1,
        episodes=100,
        clearances_mean=values["clearances"],
        clearances_std=1.0,
        instructions_mean=values["instructions"],
        success_rate=values["success"],
        correct_exit_rate=1.0,
        excursion_rate=0.0,
        few_clearances_rate=1.0,
        loss_of_separation_count=0,
        statistics=statistics,
    )


def judged(folder, figures, **more):
    results = Results(
        rows=[row(*name, values) for name, values in figures.items()],
        rows_by_seed=[],
        train=more.pop("train", []),
        wall_s=1.0,
        machine="",
        version="",
        command="",
        quick=False,
        **more,
    )
    return {claim.words: claim for claim in judge_claims(Run(folder, results, None))}


def test_the_papers_own_figures_are_reproduced(tmp_path):
    found = judged(tmp_path, {name: dict(values) for name, values in PAPER.items()} | LARGE_EQUAL)
    verdicts = {words: claim.verdict for words, claim in found.items()}
    assert len(verdicts) == 13
    assert set(verdicts.values()) == {REPRODUCED}, verdicts


LARGE_EQUAL = {("lateral-large", False): {"clearances": 7.2}}
"""No more than 37 actions: the paper calls 7.2 and 6.3 the same."""


@pytest.mark.parametrize(
    ("words", "changed"),
    [
        ("damping cuts instructions by about 87 %", {("lateral", False): {"instructions": 40.0}}),
        (
            "stacking about halves them again at equal success",
            {("lateral", True): {"clearances": 13.0}},
        ),
        (
            "stacking about halves them again at equal success",
            {("lateral", True): {"clearances": 7.2, "success": 0.9}},
        ),
        (
            "undamped behaviour cannot be stacked",
            {("lateral-undamped", True): {"clearances": 50.0}},
        ),
        ("five stacked actions do as well as 37", {("lateral", True): {"clearances": 8.0}}),
        ("clearances, damped and stacked", {("lateral", True): {"clearances": 10.8}}),
        (
            "separation is lost in 1 scenario of 100",
            {("avoidance", True): {"loss_of_separation": 0.02}},
        ),
        (
            "stacked, separation is lost less often than with 37 actions",
            {("avoidance", True): {"loss_of_separation": 0.09}},
        ),
        (
            "stacked, clearances are fewer than with 37 actions",
            {("avoidance", True): {"clearances": 127.0}},
        ),
    ],
)
def test_contrary_figures_are_not_reproduced(tmp_path, words, changed):
    figures = {name: dict(values) for name, values in PAPER.items()} | LARGE_EQUAL
    assert judged(tmp_path, figures)[words].verdict == REPRODUCED
    assert judged(tmp_path, figures | changed)[words].verdict == MISSED


def test_what_holds_with_changed_values_only_says_so(tmp_path):
    figures = {name: dict(values) for name, values in PAPER.items()}
    figures[("lateral", False)] = {"clearances": 40.0, "instructions": 40.0}
    figures[("lateral-tuned", False)] = {"clearances": 14.0, "instructions": 14.0}
    found = judged(tmp_path, figures)
    assert found["damping cuts instructions by about 87 %"].verdict == CHANGED
    assert found["instructions of the damped policy"].verdict == CHANGED


def test_the_difference_of_the_papers_figures_is_judged_by_its_interval(tmp_path):
    """Welch: t = 0.9 / sqrt((3.5^2 + 3.0^2) / 100) = 1.95 with 193 degrees of freedom."""
    words = "6.3 against 7.2 is no significant difference"

    def claim(low, high):
        gap = Difference(Estimate(0.9, low, high), Estimate(0.5, 0.0, 1.0))
        names = RowName("lateral", True), RowName("lateral-large", False)
        compared = [Comparison(*names, {"clearances": gap})]
        return judged(tmp_path, PAPER, comparisons=compared)[words]

    assert "p = 0.052" in claim(-0.1, 1.9).paper
    assert claim(-0.1, 1.9).verdict == REPRODUCED
    assert claim(0.1, 1.7).verdict == MISSED


def curve(folder, name, success, few):
    lines = [
        {"steps": 1000 * (number + 1), "success": value, "correct_exit": 0.99}
        | {"excursion": 0.01, "few_instructions": few, "episodes": 10.0}
        for number, value in enumerate(success)
    ]
    (folder / "train" / name).mkdir(parents=True)
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (folder / "train" / name / "metrics.jsonl").write_text(text)


def test_the_sooner_one_converges_faster(tmp_path):
    curve(tmp_path, "lateral-s0", [0.0, 0.9, 0.9, 0.9], few=1.0)
    curve(tmp_path, "lateral-large-s0", [0.0, 0.0, 0.0, 0.2], few=0.3)
    train = [Training(name, 0, 4000, 1.0, 4000.0) for name in ("lateral", "lateral-large")]
    found = judged(tmp_path, PAPER, train=train)
    claim = found["the small action space converges faster"]
    assert (claim.verdict, claim.found) == (REPRODUCED, "0.00 million against never")
    claim = found["the count criterion is what lowers the large policy's success"]
    assert (claim.verdict, claim.found) == (
        REPRODUCED,
        "at the end: exit 99 %, bounds 99 %, count 30 %",
    )


@pytest.mark.parametrize(("last", "verdict"), [(1, REPRODUCED), (2, MISSED)])
def test_climbs_of_150_levels_become_one_clearance(tmp_path, last, verdict):
    aircraft = {"scenario": [0, 1, 2], "entry_fl": [100, 250, 200], "exit_fl": [250, 100, 300]}
    for way, clearances in (("plain", [15, 15, 10]), ("stacked", [1, last, 9])):
        folder = tmp_path / "evaluation" / f"vertical-s0-skystack-{way}"
        folder.mkdir(parents=True)
        pq.write_table(pa.table(aircraft), folder / "aircraft.parquet")
        episodes = pa.table({"scenario": [0, 1, 2], "clearances": clearances})
        pq.write_table(episodes, folder / "episodes.parquet")
    rows = {("vertical", way): {} for way in (False, True)}
    claim = judged(tmp_path, rows)["an instruction of fifteen steps becomes one"]
    assert claim.verdict == verdict
    assert claim.found.startswith("2 climbs and descents: 15.0 to 1.")


def test_a_run_without_statistics_has_no_claims(tmp_path):
    plain = row("lateral", False, {})
    bare = {name: getattr(plain, name) for name in plain.__struct_fields__} | {"statistics": {}}
    results = Results(
        rows=[Row(**bare)], rows_by_seed=[], train=[], wall_s=1.0, machine="", version="",
        command="", quick=False,
    )  # fmt: skip
    assert judge_claims(Run(tmp_path, results, None)) == []
    assert claims_table([]).rows == ()
