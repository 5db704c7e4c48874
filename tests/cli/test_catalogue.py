"""The shipped policies: their cards, their recorded results, and the tables of `list`."""

import json
import shutil

import pytest
from rich.console import Console

from skystack.cli import catalogue
from skystack.errors import InputError
from skystack.evaluation.evaluate import Conditions, evaluate
from skystack.policies import measured, shipped
from skystack.policies.measured import read_measured
from skystack.policies.shipped import (
    SHIPPED,
    find_policy,
    scenario_policies,
    shipped_policies,
)
from skystack.reporting import model_card
from skystack.reporting.tables import NOTHING

KEYS = ("stacking", "episodes")


@pytest.fixture
def only_lateral(tmp_path, monkeypatch):
    """A package that ships one policy, which the test may damage."""
    shutil.copytree(SHIPPED / "lateral", tmp_path / "lateral")
    monkeypatch.setattr(shipped, "SHIPPED", tmp_path)
    return tmp_path / "lateral"


def printed_lines(width):
    """The tables of `list` in a terminal of the given width."""
    console = Console(width=width)
    with console.capture() as capture:
        for table in catalogue.catalogue_table(catalogue.catalogue()):
            console.print(table)
    return capture.get().splitlines()


def line_of(name, width=120):
    """The line of a policy in the last table."""
    return next(line for line in reversed(printed_lines(width)) if line.split()[:1] == [name])


@pytest.mark.parametrize("name", scenario_policies())
def test_recorded_results_belong_to_the_shipped_policy(name):
    found = read_measured(SHIPPED / name)
    assert found.sha256 == find_policy(name).description.sha256
    conditions = [tuple(row[key] for key in KEYS) for row in found.rows]
    assert conditions == [(False, 1000), (True, 1000), (True, 10_000)]
    assert {row["experiment"] for row in found.rows} == {name}
    assert all(row["platform"] == "skystack" and row["greedy"] for row in found.rows)


@pytest.mark.parametrize("name", shipped_policies())
def test_card_matches_its_template(name):
    """To update the cards after a change, run `python -m tools.ship_policies --cards`."""
    card = model_card.card(name, find_policy(name), read_measured(SHIPPED / name))
    assert (SHIPPED / name / model_card.FILE).read_text("utf-8") == card


@pytest.mark.slow
def test_flights_reproduce_the_recorded_results():
    """Within tolerances, because other processors may break ties of logits differently."""
    recorded = read_measured(SHIPPED / "vertical").stacked
    flown = evaluate(find_policy("vertical"), Conditions(episodes=recorded["episodes"]), None).row
    for key in ("clearances_mean", "clearances_std", "instructions_mean"):
        assert flown[key] == pytest.approx(recorded[key], rel=2e-3), key
    for key in ("success_rate", "correct_exit_rate", "excursion_rate", "few_clearances_rate"):
        assert flown[key] == pytest.approx(recorded[key], abs=2e-3), key


def test_list_has_stacked_results_and_paper_values():
    policies = catalogue.catalogue()["policies"]
    assert list(policies) == shipped_policies()
    for name in scenario_policies():
        policy = policies[name]
        assert policy["stacked"] == read_measured(SHIPPED / name).rows[1]
    assert policies["lateral"]["paper"] == {
        "clearances_mean": 7.2,
        "clearances_std": 3.5,
        "stacking": True,
    }
    assert policies["lateral-undamped"]["paper"]["stacking"] is False
    assert policies["lateral-best"]["paper"] is None
    assert json.loads(json.dumps(policies)) == policies


@pytest.mark.parametrize("width", [80, 120])
def test_list_fits_the_terminal(width):
    lines = printed_lines(width)
    assert max(map(len, lines)) <= width
    recorded = read_measured(SHIPPED / "lateral-undamped").stacked
    line = line_of("lateral-undamped", width)
    for text in (
        f"{recorded['clearances_mean']:.1f} ± {recorded['clearances_std']:.1f}",
        f"{recorded['loss_of_separation_count']} of 1000",
        "113.0 ± 15.9 unstacked",
    ):
        assert text in line


def test_policy_without_results_shows_dashes(only_lateral):
    (only_lateral / measured.FILE).unlink()
    assert catalogue.catalogue()["policies"]["lateral"]["stacked"] is None
    assert line_of("lateral").split() == ["lateral", *[NOTHING] * 3, "7.2", "±", "3.5"]


def test_results_of_another_policy_are_not_shown(only_lateral):
    shutil.copy(SHIPPED / "vertical" / measured.FILE, only_lateral)
    assert catalogue.catalogue()["policies"]["lateral"]["stacked"] is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "damaged: "),
        ('{"format": 1}', "damaged: sha256 is missing"),
        (
            '{"format": 2, "sha256": "", "machine": "", "version": "", "git_revision": null, '
            '"rows": []}',
            "format 2 (allowed: 1)",
        ),
    ],
)
def test_damaged_results_are_errors(only_lateral, text, message):
    path = only_lateral / measured.FILE
    path.write_text(text)
    with pytest.raises(InputError) as error:
        catalogue.catalogue()
    assert str(path) in str(error.value)
    assert message in str(error.value)
