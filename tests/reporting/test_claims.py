"""Claims: the paper's own figures support them, contradicting figures do not."""

import json

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skystack.evaluation.estimate import Estimate
from skystack.evaluation.statistics import MEASURES
from skystack.reporting.claims import (
    CHANGED,
    MISSED,
    REPRODUCED,
    UNDECIDED,
    Claim,
    check_claims,
    claims_table,
)
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
    # Wide intervals and different interquartile means: only the mean should count.
    statistics = {
        name: Statistics(
            Estimate(value, 0.5 * value, 2.0 * value), Estimate(3.0 * value, 0.0, 9.0 * value)
        )
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


def claims_of(folder, figures, **more):
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
    return {claim.words: claim for claim in check_claims(Run(folder, results, None))}


def test_paper_figures_support_all_claims(tmp_path):
    found = claims_of(
        tmp_path, {name: dict(values) for name, values in PAPER.items()} | LARGE_EQUAL
    )
    verdicts = {words: claim.verdict for words, claim in found.items()}
    assert len(verdicts) == 13
    assert set(verdicts.values()) == {REPRODUCED}, verdicts


CLAIMS = [
    (
        "undamped policies issue an instruction at almost every step",
        "113.0 ± 15.9",
        "standard deviation",
    ),
    ("instructions per scenario, damped", "14.5 ± 6.6", "standard deviation"),
    ("clearances per scenario, damped and stacked", "7.2 ± 3.5", "standard deviation"),
    ("instructions per scenario, 37 actions", "6.3 ± 3.0", "standard deviation"),
    ("damping reduces instructions by about 87 %", "113.0 to 14.5", "82 to 92 %"),
    ("stacking roughly halves the clearances at equal success", "14.5 to 7.2", "40 % or more"),
    ("stacking hardly helps undamped policies", "\N{EN DASH}", "less than 20 %"),
    (
        "5 actions with stacking perform as well as 37 actions",
        "7.2 against 6.3",
        "no more clearances, success at",
    ),
    ("the difference between 6.3 and 7.2 is not significant", "p = 0.052 (Welch's", "contains 0"),
    ("the small action space converges faster", "earlier and", "80 % success after fewer steps"),
    ("the count criterion limits the success of 37 actions", "\N{EN DASH}", "less often"),
    (
        "a burst of fifteen instructions becomes one clearance",
        "15 to 1",
        "one clearance in every case",
    ),
    ("clearances per scenario, avoidance, stacked", "81.2 ± 13.2", "standard deviation"),
    ("instructions per scenario, avoidance, 37 actions", "126.3 ± 12.3", "standard deviation"),
    ("separation is lost in 1 of 100 scenarios", "1 %", "1 % or less"),
    (
        "with stacking, separation is lost less often than with 37 actions",
        "1 against 9 of 100",
        "lower mean",
    ),
    (
        "with stacking, there are fewer clearances than with 37 actions",
        "81.2 against 126.3",
        "lower mean",
    ),
]
"""All claims in the order of the paper: words, the paper's numbers, part of the criterion."""


def all_claims(folder, changed=None):
    """All claims, from the paper's figures and these."""
    vertical = {("vertical", way): {} for way in (False, True)}
    write_climbs(folder, [15], [1])
    gap = Difference(Estimate(0.9, -0.1, 1.9), Estimate(0.5, 0.0, 1.0))
    names = RowName("lateral", True), RowName("lateral-large", False)
    last = {"success": 0.9, "correct_exit": 0.99, "excursion": 0.01, "few_instructions": 0.5}
    return claims_after(
        folder,
        PAPER | vertical | (changed or {}),
        comparisons=[Comparison(*names, {"clearances": gap})],
        lateral=[[last]],
        lateral_large=[[last]],
    )


def test_claims_are_in_the_papers_order_with_its_figures(tmp_path):
    found = all_claims(tmp_path)
    for claim, (words, figures, criterion) in zip(found.values(), CLAIMS, strict=True):
        assert claim.words == words
        assert claim.paper.startswith(figures)
        assert criterion in claim.asked
    families = [claim.family for claim in found.values()]
    assert families == ["lateral"] * 11 + ["vertical"] + ["avoidance"] * 5


ABOUT = {
    ("lateral-undamped", False): {0, 4, 6},
    ("lateral-undamped", True): {6},
    ("lateral", False): {1, 4, 5, 9, 10},
    ("lateral", True): {2, 5, 7, 8},
    ("lateral-large", False): {3, 7, 8, 9, 10},
    ("vertical", False): {11},
    ("vertical", True): {11},
    ("avoidance", True): {12, 14, 15, 16},
    ("avoidance-large", False): {13, 15, 16},
}
"""The places in `CLAIMS` of the claims that a row is involved in."""


@pytest.mark.parametrize("name", ABOUT)
def test_claims_about_untrained_policies_are_undecided(tmp_path, name):
    """The others are not affected."""
    before = all_claims(tmp_path)
    after = all_claims(tmp_path, {name: PAPER.get(name, {}) | {"success": 0.29}})
    assert list(before) == list(after) == [words for words, *_ in CLAIMS]
    for place, words in enumerate(before):
        if place in ABOUT[name]:
            assert after[words].verdict == UNDECIDED, words
            assert after[words].found.endswith(" (not trained)")
        else:
            assert after[words] == before[words]


@pytest.mark.parametrize("idle", ["do-nothing-lateral", "do-nothing"])
def test_trained_means_clearly_better_than_doing_nothing(tmp_path, idle):
    """All scenarios succeed, which is 29 points, or exactly 30, above doing nothing."""
    words = "clearances per scenario, damped and stacked"

    def claim(success_rate):
        idling = {(idle, False): {"clearances": 0.0, "success": success_rate}}
        return claims_of(tmp_path, PAPER | idling)[words]

    assert claim(0.71).verdict == UNDECIDED
    assert claim(0.70).verdict == REPRODUCED
    assert claim(0.71).found == "as stated: 7.2 [3.6, 14.4] (not trained)"
    assert claim(0.70).found == "as stated: 7.2 [3.6, 14.4]"


@pytest.mark.parametrize(
    ("stated", "tuned", "verdict"),
    [
        # Each with the clearances, of which 7.2 support the claim, and the success rate.
        ((7.2, 0.2), (7.2, 0.9), CHANGED),
        ((7.2, 0.2), (20.0, 0.9), UNDECIDED),
        ((7.2, 0.2), (7.2, 0.2), UNDECIDED),
        ((20.0, 0.2), (20.0, 0.2), UNDECIDED),
        ((20.0, 0.9), (7.2, 0.9), CHANGED),
        ((20.0, 0.9), (7.2, 0.2), MISSED),
        ((20.0, 0.9), (20.0, 0.9), MISSED),
        ((7.2, 0.9), (7.2, 0.2), REPRODUCED),
        ((7.2, 0.9), (20.0, 0.9), REPRODUCED),
    ],
)
def test_verdict_if_the_stated_or_tuned_row_is_not_trained(tmp_path, stated, tuned, verdict):
    rows = {("lateral", True): rates(*stated), ("lateral-tuned", True): rates(*tuned)}
    claim = claims_of(tmp_path, rows)["clearances per scenario, damped and stacked"]
    assert claim.verdict == verdict
    for part, (_, success_rate) in zip(claim.found.split("; "), (stated, tuned), strict=True):
        assert part.endswith(" (not trained)") == (success_rate < 0.3)


def test_claims_table_has_one_line_per_claim():
    claim = Claim("family", "words", "paper", "asked", "found", "verdict")
    table = claims_table([claim, claim])
    assert table.header == ("claim", "paper", "criterion", "measured", "verdict")
    assert table.rows == (("words", "paper", "asked", "found", "verdict"),) * 2


LARGE_EQUAL = {("lateral-large", False): {"clearances": 7.2}}
"""No fewer than with 5 actions; the paper considers 7.2 and 6.3 equal."""


@pytest.mark.parametrize(
    ("words", "changed"),
    [
        (
            "damping reduces instructions by about 87 %",
            {("lateral", False): {"instructions": 40.0}},
        ),
        (
            "stacking roughly halves the clearances at equal success",
            {("lateral", True): {"clearances": 13.0}},
        ),
        (
            "stacking roughly halves the clearances at equal success",
            {("lateral", True): {"clearances": 7.2, "success": 0.9}},
        ),
        (
            "stacking hardly helps undamped policies",
            {("lateral-undamped", True): {"clearances": 50.0}},
        ),
        (
            "5 actions with stacking perform as well as 37 actions",
            {("lateral", True): {"clearances": 8.0}},
        ),
        ("clearances per scenario, damped and stacked", {("lateral", True): {"clearances": 10.8}}),
        (
            "separation is lost in 1 of 100 scenarios",
            {("avoidance", True): {"loss_of_separation": 0.02}},
        ),
        (
            "with stacking, separation is lost less often than with 37 actions",
            {("avoidance", True): {"loss_of_separation": 0.09}},
        ),
        (
            "with stacking, there are fewer clearances than with 37 actions",
            {("avoidance", True): {"clearances": 127.0}},
        ),
    ],
)
def test_contrary_figures_are_not_reproduced(tmp_path, words, changed):
    figures = {name: dict(values) for name, values in PAPER.items()} | LARGE_EQUAL
    assert claims_of(tmp_path, figures)[words].verdict == REPRODUCED
    assert claims_of(tmp_path, figures | changed)[words].verdict == MISSED


COUNTS = {
    "undamped policies issue an instruction at almost every step": (
        "lateral-undamped",
        False,
        113.0,
        15.9,
    ),
    "instructions per scenario, damped": ("lateral", False, 14.5, 6.6),
    "clearances per scenario, damped and stacked": ("lateral", True, 7.2, 3.5),
    "instructions per scenario, 37 actions": ("lateral-large", False, 6.3, 3.0),
    "clearances per scenario, avoidance, stacked": ("avoidance", True, 81.2, 13.2),
    "instructions per scenario, avoidance, 37 actions": ("avoidance-large", False, 126.3, 12.3),
}
"""The paper's figures by claim: experiment, stacking, mean, standard deviation."""


@pytest.mark.parametrize("words", COUNTS)
def test_counts_may_differ_by_the_papers_standard_deviation(tmp_path, words):
    experiment, stacking, mean, spread = COUNTS[words]

    def claim(clearances):
        return claims_of(tmp_path, {(experiment, stacking): {"clearances": clearances}})[words]

    assert claim(mean).paper == f"{mean} ± {spread}"
    for side in (-1.0, 1.0):
        assert claim(mean + side * spread).verdict == REPRODUCED
        assert claim(mean + side * (spread + 0.1)).verdict == MISSED


def lateral(undamped=None, undamped_stacked=None, plain=None, stacked=None, large=None):
    """The rows of lateral navigation for which figures are given."""
    names = [(f"lateral{suffix}", stacking) for suffix, stacking in LATERAL]
    each = zip(names, (undamped, undamped_stacked, plain, stacked, large), strict=True)
    return {name: values for name, values in each if values is not None}


LATERAL = [("-undamped", False), ("-undamped", True), ("", False), ("", True), ("-large", False)]


@pytest.mark.parametrize(
    ("instructions", "verdict", "cut"),
    [
        (18.1, MISSED, "82 %"),
        (18.0, REPRODUCED, "82 %"),
        (13.0, REPRODUCED, "87 %"),
        (8.0, REPRODUCED, "92 %"),
        (7.9, MISSED, "92 %"),
    ],
)
def test_damping_cuts_instructions_by_82_to_92_percent(tmp_path, instructions, verdict, cut):
    """Only instructions count, not the clearances that are compiled from them."""
    undamped = {"instructions": 100.0, "clearances": 1000.0}
    plain = {"instructions": instructions, "clearances": 1.0}
    found = claims_of(tmp_path, lateral(undamped=undamped, plain=plain))
    claim = found["damping reduces instructions by about 87 %"]
    assert (claim.verdict, claim.found) == (verdict, f"as stated: {cut}")


def rates(clearances, success):
    return {"clearances": clearances, "success": success}


@pytest.mark.parametrize(
    ("plain", "stacked", "verdict", "figures"),
    [
        ((20.0, 0.9), (12.0, 0.95), REPRODUCED, "40 %, success +5.0 points"),
        ((20.0, 0.9), (12.1, 0.95), MISSED, "40 %, success +5.0 points"),
        ((20.0, 0.99), (5.0, 0.98), REPRODUCED, "75 %, success -1.0 points"),
        ((20.0, 0.99), (5.0, 0.978), MISSED, "75 %, success -1.2 points"),
        ((0.0, 1.0), (0.0, 1.0), MISSED, "0 %, success +0.0 points"),
    ],
)
def test_stacking_cuts_clearances_by_40_percent_at_equal_success(
    tmp_path, plain, stacked, verdict, figures
):
    """Success rates within one point are equal. A policy that never acts cuts nothing."""
    found = claims_of(tmp_path, lateral(plain=rates(*plain), stacked=rates(*stacked)))
    claim = found["stacking roughly halves the clearances at equal success"]
    assert (claim.verdict, claim.found) == (verdict, f"as stated: {figures}")


def test_compares_each_row_with_its_stacked_counterpart(tmp_path):
    figures = lateral(plain=rates(20.0, 1.0), stacked=rates(19.0, 1.0))
    figures[("lateral-tuned", False)] = rates(10.0, 1.0)
    figures[("lateral-tuned", True)] = rates(4.0, 1.0)
    claim = claims_of(tmp_path, figures)["stacking roughly halves the clearances at equal success"]
    assert claim.verdict == CHANGED
    assert claim.found == ("as stated: 5 %, success +0.0 points; tuned: 60 %, success +0.0 points")
    figures[("lateral", True)] = rates(10.0, 1.0)
    figures[("lateral-tuned", True)] = rates(10.0, 1.0)
    claim = claims_of(tmp_path, figures)["stacking roughly halves the clearances at equal success"]
    assert claim.verdict == REPRODUCED  # it holds with the stated settings


@pytest.mark.parametrize(("clearances", "verdict"), [(80.1, REPRODUCED), (80.0, MISSED)])
def test_stacking_cuts_undamped_clearances_by_less_than_20(tmp_path, clearances, verdict):
    rows = lateral(undamped=rates(100.0, 1.0), undamped_stacked=rates(clearances, 1.0))
    claim = claims_of(tmp_path, rows)["stacking hardly helps undamped policies"]
    assert claim.verdict == verdict
    assert claim.found.startswith("100.0 [50.0, 200.0] to 80.")
    assert claim.found.endswith(": 20 %")


@pytest.mark.parametrize(
    ("stacked", "large", "verdict"),
    [
        ((7.0, 0.9), (7.0, 0.91), REPRODUCED),
        ((7.0, 0.9), (7.0, 0.912), MISSED),
        ((7.1, 0.9), (7.0, 0.5), MISSED),
        ((6.9, 0.5), (7.0, 0.9), MISSED),
    ],
)
def test_5_actions_need_no_more_clearances_and_equal_success(tmp_path, stacked, large, verdict):
    found = claims_of(tmp_path, lateral(stacked=rates(*stacked), large=rates(*large)))
    claim = found["5 actions with stacking perform as well as 37 actions"]
    assert claim.verdict == verdict
    (ours, half, twice), (theirs, low, high) = (
        [f"{factor * row[0]:.1f}" for factor in (1.0, 0.5, 2.0)] for row in (stacked, large)
    )
    assert claim.found == (
        f"as stated: {ours} [{half}, {twice}] against {theirs} [{low}, {high}], "
        f"success {stacked[1]:.3f} against {large[1]:.3f}"
    )


@pytest.mark.parametrize(
    ("lost", "verdict"), [(0.01, REPRODUCED), (0.0101, MISSED), (0.002, REPRODUCED)]
)
def test_separation_may_be_lost_in_1_of_100_scenarios(tmp_path, lost, verdict):
    """The mean of the stacked row counts."""
    rows = {
        ("avoidance", False): {"loss_of_separation": 0.0 if verdict == MISSED else 1.0},
        ("avoidance", True): {"loss_of_separation": lost},
    }
    claim = claims_of(tmp_path, rows)["separation is lost in 1 of 100 scenarios"]
    assert claim.verdict == verdict
    assert claim.found.startswith(f"as stated: {100.0 * lost:.1f} % [")


def test_avoidance_must_be_strictly_better_than_37_actions(tmp_path):
    """Equal figures do not suffice. The first figure is that of the stacked row."""
    rows = {
        ("avoidance", True): {"loss_of_separation": 0.04, "clearances": 20.0},
        ("avoidance-large", False): {"loss_of_separation": 0.04, "clearances": 20.0},
    }
    lost = "with stacking, separation is lost less often than with 37 actions"
    fewer = "with stacking, there are fewer clearances than with 37 actions"
    found = claims_of(tmp_path, rows)
    assert (found[lost].verdict, found[fewer].verdict) == (MISSED, MISSED)
    rows[("avoidance", True)] = {"loss_of_separation": 0.03, "clearances": 19.0}
    found = claims_of(tmp_path, rows)
    assert (found[lost].verdict, found[fewer].verdict) == (REPRODUCED, REPRODUCED)
    assert found[lost].found == "as stated: 3.0 % [1.5, 6.0] against 4.0 % [2.0, 8.0]"
    assert found[fewer].found == "as stated: 19.0 [9.5, 38.0] against 20.0 [10.0, 40.0]"


def test_verdict_states_if_only_changed_settings_reproduce(tmp_path):
    figures = {name: dict(values) for name, values in PAPER.items()}
    figures[("lateral", False)] = {"clearances": 40.0, "instructions": 40.0}
    figures[("lateral-tuned", False)] = {"clearances": 14.0, "instructions": 14.0}
    found = claims_of(tmp_path, figures)
    assert found["damping reduces instructions by about 87 %"].verdict == CHANGED
    assert found["instructions per scenario, damped"].verdict == CHANGED


@pytest.mark.parametrize(
    ("clearances", "verdict"), [(7.2, CHANGED), (20.0, MISSED)], ids=["holds", "fails"]
)
def test_changed_settings_alone_never_reproduce_a_claim(tmp_path, clearances, verdict):
    figures = {("lateral-tuned", True): {"clearances": clearances}}
    found = claims_of(tmp_path, figures)
    assert found["clearances per scenario, damped and stacked"].verdict == verdict


def test_significance_is_decided_by_the_confidence_interval(tmp_path):
    """Welch: t = 0.9 / sqrt((3.5^2 + 3.0^2) / 100) = 1.95 with 193 degrees of freedom."""
    words = "the difference between 6.3 and 7.2 is not significant"

    def claim(low, high):
        gap = Difference(Estimate(0.9, low, high), Estimate(0.5, 0.0, 1.0))
        other = Difference(Estimate(9.0, 8.0, 10.0), Estimate(0.5, 0.0, 1.0))
        stacked, large = RowName("lateral", True), RowName("lateral-large", False)
        compared = [
            Comparison(stacked, RowName("lateral", False), {"clearances": other}),
            Comparison(RowName("lateral", False), large, {"clearances": other}),
            Comparison(stacked, large, {"clearances": gap, "success": other}),
        ]
        return claims_of(tmp_path, PAPER, comparisons=compared)[words]

    assert "p = 0.052" in claim(-0.1, 1.9).paper
    assert claim(-0.1, 1.9).verdict == REPRODUCED
    assert claim(-0.1, 1.9).found == "as stated: 0.9 [-0.1, 1.9]"
    assert claim(0.0, 1.7).verdict == claim(-0.1, 0.0).verdict == REPRODUCED
    assert claim(0.1, 1.7).verdict == claim(-1.7, -0.1).verdict == MISSED


def claims_after(folder, figures=PAPER, comparisons=(), **curves):
    """Claims after trainings, each given as fields of its updates, a million steps apart."""
    train = []
    for name, seeds in curves.items():
        experiment = name.replace("_", "-")
        for seed, updates in enumerate(seeds):
            lines = [
                {"steps": 1_000_000 * (number + 1), "episodes": 10.0} | fields
                for number, fields in enumerate(updates)
            ]
            path = folder / "train" / f"{experiment}-s{seed}" / "metrics.jsonl"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("".join(json.dumps(line) + "\n" for line in lines))
            train.append(Training(experiment, seed, 1, 1.0, 1.0))
    return claims_of(folder, figures, train=train, comparisons=list(comparisons))


def success(*values):
    return [{"success": value} for value in values]


FASTER = "the small action space converges faster"
SOON, LATE, NEVER = success(0.1, 0.8, 0.9), success(0.1, 0.79, 0.8), success(0.1, 0.79, 0.7)


@pytest.mark.parametrize(
    ("small", "large", "verdict", "figures"),
    [
        ([SOON], [NEVER], REPRODUCED, "2.00 million steps against never"),
        ([SOON], [LATE], REPRODUCED, "2.00 million steps against 3.00 million steps"),
        ([LATE], [LATE], MISSED, "3.00 million steps against 3.00 million steps"),
        ([NEVER], [NEVER], MISSED, "never against never"),
        ([LATE], [SOON], MISSED, "3.00 million steps against 2.00 million steps"),
        ([SOON, LATE, LATE], [NEVER], REPRODUCED, "3.00 million steps against never"),
        ([LATE], [NEVER, SOON, NEVER], REPRODUCED, "3.00 million steps against never"),
    ],
)
def test_converging_faster_means_80_percent_in_fewer_steps(
    tmp_path, small, large, verdict, figures
):
    """The median over seeds counts. Exactly 80 % is enough, a tie is not."""
    claim = claims_after(tmp_path, lateral=small, lateral_large=large)[FASTER]
    assert (claim.verdict, claim.found) == (verdict, figures)


def test_training_success_is_averaged_over_scenarios(tmp_path):
    """Of forty updates, the running mean covers three: (1 + 1 + 9) scenarios, 9 successes."""
    few = [{"success": 0.0, "episodes": 1.0}] * 20
    curve = [*few, *[{"success": 1.0, "episodes": 9.0}] * 20]
    claim = claims_after(tmp_path, lateral=[curve], lateral_large=[NEVER])[FASTER]
    assert claim.found == "20.00 million steps against never"


COUNT = "the count criterion limits the success of 37 actions"
SHARES = "at the end of training: correct exit {}, no excursion {}, few instructions {}"


@pytest.mark.parametrize(
    ("exits", "excursion", "few", "verdict"),
    [
        (0.99, 0.01, 0.30, REPRODUCED),
        (0.90, 0.05, 0.88, REPRODUCED),
        (0.90, 0.05, 0.89, MISSED),  # one point less is equal
        (0.90, 0.05, 0.93, MISSED),
        (0.95, 0.10, 0.93, MISSED),
        (0.95, 0.10, 0.80, REPRODUCED),
    ],
)
def test_count_criterion_is_met_less_often_than_the_others(
    tmp_path, exits, excursion, few, verdict
):
    """Only the end of training counts."""
    last = {"correct_exit": exits, "excursion": excursion, "few_instructions": few}
    first = {name: 1.0 - value for name, value in last.items()}
    updates = [fields | {"success": 0.0} for fields in (first, last)]
    claim = claims_after(tmp_path, lateral=[SOON], lateral_large=[updates, updates])[COUNT]
    rounded = [f"{100.0 * value:.0f} %" for value in (exits, 1.0 - excursion, few)]
    assert claim.verdict == verdict
    assert claim.found == SHARES.format(*rounded)


@pytest.mark.parametrize("unknown", ["correct_exit", "excursion", "few_instructions"])
def test_no_count_claim_if_a_criterion_is_unknown(tmp_path, unknown):
    known = {"correct_exit": 0.9, "excursion": 0.1, "few_instructions": 0.5, "success": 0.0}
    large = [[known], [{name: value for name, value in known.items() if name != unknown}]]
    assert COUNT in claims_after(tmp_path, lateral=[SOON], lateral_large=large)
    assert COUNT not in claims_after(tmp_path, lateral=[SOON], lateral_large=large[1:])


CLIMBS = {"entry_fl": [100, 250, 140, 150, 100], "exit_fl": [250, 100, 280, 0, 260]}
"""Level changes of 150, -150, 140, -150 and 160 flight levels."""


def write_climbs(folder, plain, stacked):
    """Write the clearances of the first scenarios, which are numbered from 7."""
    for way, clearances in (("plain", plain), ("stacked", stacked)):
        where = folder / "evaluation" / f"vertical-s0-skystack-{way}"
        where.mkdir(parents=True, exist_ok=True)
        numbers = list(range(7, 7 + len(clearances)))
        aircraft = {name: values[: len(numbers)] for name, values in CLIMBS.items()}
        pq.write_table(pa.table({"scenario": numbers} | aircraft), where / "aircraft.parquet")
        episodes = pa.table({"clearances": clearances, "scenario": numbers})
        pq.write_table(episodes, where / "episodes.parquet")


@pytest.mark.parametrize(
    ("plain", "stacked", "verdict", "figures"),
    [
        ([15, 14, 10, 16, 9], [1, 1, 9, 1, 9], REPRODUCED, "3 climbs and descents: 15.0 to 1.00"),
        ([15, 14, 10, 16, 9], [1, 2, 1, 1, 1], MISSED, "3 climbs and descents: 15.0 to 1.33"),
        ([15, 14, 10, 16, 9], [1, 0, 1, 1, 1], MISSED, "3 climbs and descents: 15.0 to 0.67"),
    ],
)
def test_climbs_of_150_levels_become_one_clearance(tmp_path, plain, stacked, verdict, figures):
    """Each climb and descent of 150 levels counts, others are ignored."""
    write_climbs(tmp_path, plain, stacked)
    rows = {("vertical", way): {} for way in (False, True)}
    claim = claims_of(tmp_path, rows)["a burst of fifteen instructions becomes one clearance"]
    assert (claim.verdict, claim.found) == (verdict, figures)


def test_no_claims_without_statistics(tmp_path):
    plain = row("lateral", False, {})
    bare = {name: getattr(plain, name) for name in plain.__struct_fields__} | {"statistics": {}}
    results = Results(
        rows=[Row(**bare)], rows_by_seed=[], train=[], wall_s=1.0, machine="", version="",
        command="", quick=False,
    )  # fmt: skip
    assert check_claims(Run(tmp_path, results, None)) == []
    results = msgspec.structs.replace(results, rows=[plain, Row(**bare)])
    assert check_claims(Run(tmp_path, results, None)) == []
    assert claims_table([]).rows == ()
