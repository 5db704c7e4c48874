"""A share of the mutated inputs in process: each is read, or refused in one clear line."""

from random import Random

import pytest

from benchmarks.mutated_inputs import Trial, try_inputs
from benchmarks.untrusted_files import FORMATS, Format
from skystack.errors import InputError

COUNTS = {"tables": 150, "checkpoint": 300, "run-folder": 100}
"""Fewer than 1,000 of those that take long each; the others' share is cut by SECONDS."""
SECONDS = 5.0


@pytest.mark.parametrize("name", FORMATS)
def test_mutated_files_are_read_or_refused_in_one_line(name):
    tally = try_inputs(FORMATS[name](), range(COUNTS.get(name, 1000)), 1, SECONDS)
    assert not tally.findings
    assert tally.refused > 0


def faulty(answer):
    def read(folder):
        if (folder / "a.json").read_bytes() != b"[1]":
            answer()

    return Format("faulty", ({"a.json": b"[1]"},), read)


def raising(error):
    def answer():
        raise error

    return answer


@pytest.mark.parametrize(
    ("error", "found"),
    [
        (KeyError("x"), "KeyError"),
        (RecursionError("deep"), "RecursionError"),
        (AssertionError("holds a non-finite number"), "non-finite"),
    ],
)
def test_anything_but_a_refusal_is_a_finding(error, found):
    tally = try_inputs(faulty(raising(error)), range(20), 0, SECONDS)
    assert tally.findings
    assert all(found in each for each in tally.findings.values())


def test_a_refusal_is_none():
    tally = try_inputs(faulty(raising(InputError("a is 2 (allowed: 1)"))), range(20), 0, SECONDS)
    assert tally.refused > 0
    assert not tally.findings


def test_an_input_depends_on_the_seed_and_its_number_only(tmp_path):
    kind = faulty(lambda: None)
    assert Trial(kind, 3, tmp_path).files(7) == Trial(kind, 3, tmp_path).files(7)
    assert kind.mutated(Random("a")) != kind.mutated(Random("b"))
