"""The family of an experiment is its task."""

import pytest

from skystack.reporting.families import family_of, family_order, family_title
from tests.reporting.rows import row


@pytest.mark.parametrize(
    ("experiment", "family"),
    [
        ("lateral", "lateral"),
        ("vertical-mine", "vertical"),
        ("avoidance-large", "avoidance"),
        ("do-nothing", "lateral"),
        ("do-nothing-lateral", "lateral"),
        ("lateral-best-shipped", "lateral"),
        ("my-vertical", "other"),
        ("verticals", "other"),
    ],
)
def test_family_defaults_to_the_first_word_if_it_is_a_task(experiment, family):
    assert row(experiment=experiment).family == family_of(experiment, None) == family


def test_family_is_the_task_of_the_row():
    assert row(experiment="lateral-mine", task="holding").family == "holding"
    assert family_title("holding") == "Holding"
    assert family_order(["zebra", "vertical", "lateral", "holding"]) == [
        *("lateral", "vertical", "holding", "zebra"),
    ]
