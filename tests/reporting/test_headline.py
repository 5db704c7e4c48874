"""The sentences on the results: only of trained policies."""

import msgspec

from skystack.reporting.headline import headline
from skystack.reporting.results import Bound, Results, Row, Run


def row(experiment, stacking, clearances, success):
    return Row(
        experiment=experiment,
        task="lateral",
        platform="skystack",
        stacking=stacking,
        seeds=1,
        episodes=100,
        clearances_mean=clearances,
        clearances_std=1.0,
        instructions_mean=clearances,
        success_rate=success,
        correct_exit_rate=1.0,
        excursion_rate=0.0,
        few_clearances_rate=1.0,
        loss_of_separation_count=0,
    )


def run_of(tmp_path, rows, bound=None):
    results = Results(
        rows=rows,
        rows_by_seed=[],
        train=[],
        wall_s=1.0,
        machine="",
        version="",
        command="",
        quick=False,
    )
    return Run(tmp_path, results, bound)


ROWS = [
    row("lateral", False, 14.5, 0.99),
    row("lateral", True, 7.24, 0.985),
    row("lateral-best", True, 2.2, 0.998),
    row("do-nothing-lateral", False, 0.0, 0.03),
]


def test_headline_of_the_papers_policy_and_of_ours(tmp_path):
    bound = Bound(clearances_mean=1.6, scenarios=1000)
    assert list(headline(run_of(tmp_path, ROWS, bound))) == [
        "Lateral navigation with the paper's settings: stacking reduces the clearances per "
        "scenario from 14.5 to 7.2, at 98.5 % success.",
        "Lateral navigation with our own settings, stacked: 2.2 clearances per scenario, "
        "at 99.8 % success (fewest possible: 1.6).",
    ]


def test_headline_says_if_training_was_shortened(tmp_path):
    run = run_of(tmp_path, ROWS)
    quick = msgspec.structs.replace(run.results, quick=True)
    first, second = headline(Run(tmp_path, quick, None))
    assert first.startswith("Lateral navigation with the paper's settings, trained briefly: ")
    assert second.startswith("Lateral navigation with our own settings, trained briefly, stacked: ")


def test_untrained_policies_are_not_mentioned(tmp_path):
    rows = [msgspec.structs.replace(each, success_rate=0.3) for each in ROWS[:3]]
    assert list(headline(run_of(tmp_path, [*rows, ROWS[3]]))) == []
    rows[0] = msgspec.structs.replace(ROWS[0], success_rate=0.33)  # 30 points above doing nothing
    rows[1] = ROWS[1]
    (sentence,) = headline(run_of(tmp_path, [*rows, ROWS[3]]))
    assert sentence.startswith("Lateral navigation with the paper's settings: stacking")
