"""Mutated inputs are read, or rejected in one line; most are tried in this process."""

import ctypes
from random import Random

import pytest

from skystack.errors import InputError
from tests.verification.dying import dies_at_3
from verification.inputs import isolation
from verification.inputs.isolation import Share, try_in_process
from verification.inputs.trials import Choices, source, try_inputs
from verification.inputs.untrusted_files import FORMATS, Format

COUNT = 150
EXTRAS = {"onnx": ["onnx", "onnxruntime"], "sb3": ["stable_baselines3"]}


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_mutated_files_are_read_or_refused_in_one_line(name, tmp_path):
    for package in EXTRAS.get(name, ()):
        pytest.importorskip(package)
    tally = try_inputs(FORMATS[name](), Share(name, 0, COUNT, seed=1), tmp_path)
    assert (tally.inputs, tally.findings) == (COUNT, {})
    assert tally.refused > 0


def faulty(fault):
    """A format of one file whose reader calls a function if the file has changed."""

    def read(folder):
        if (folder / "a.json").read_bytes() != b"[1]":
            fault()

    return Format("faulty", ({"a.json": b"[1]"},), read)


def raising(error):
    def fault():
        raise error

    return fault


@pytest.mark.parametrize(
    ("error", "found"),
    [
        (KeyError("x"), "KeyError"),
        (RecursionError("deep"), "RecursionError"),
        (AssertionError("holds a non-finite number"), "non-finite"),
    ],
)
def test_anything_but_a_refusal_is_a_finding(error, found, tmp_path):
    share, folder = Share("faulty", 0, 20, keep=tmp_path / "kept"), tmp_path / "tried"
    folder.mkdir()
    tally = try_inputs(faulty(raising(error)), share, folder)
    assert tally.findings
    assert all(found in each for each in tally.findings.values())
    for number in tally.findings:  # the input is kept
        expected = faulty(None).mutated(source(share, number))
        assert (tmp_path / "kept" / f"faulty-0-{number}" / "a.json").read_bytes() == expected[
            "a.json"
        ]


@pytest.mark.parametrize("place", ["tried/b.json", "tried/new/b.json", "b.json"])
def test_a_reader_that_writes_is_a_finding(place, tmp_path):
    def write():
        (tmp_path / place).parent.mkdir(exist_ok=True)
        (tmp_path / place).write_text("x")

    folder = tmp_path / "tried"
    folder.mkdir()
    tally = try_inputs(faulty(write), Share("faulty", 0, 20), folder)
    assert tally.findings
    assert all("forbidden access" in each for each in tally.findings.values())


def test_files_written_by_native_code_are_findings(tmp_path):
    """Native code raises no audit events; here it makes a link without Python's knowledge."""
    library = ctypes.CDLL(None)
    folder = tmp_path / "tried"
    folder.mkdir()

    def write():
        library.symlink(b"nowhere", bytes(folder / "link"))
        raise InputError("refused")

    tally = try_inputs(faulty(write), Share("faulty", 0, 20), folder)
    assert "wrote ['link']" in tally.findings.values()


def test_a_refusal_is_not_a_finding(tmp_path):
    kind = faulty(raising(InputError("a is 2 (allowed: 1)")))
    tally = try_inputs(kind, Share("faulty", 0, 20), tmp_path)
    assert tally.refused > 0
    assert not tally.findings


def test_inputs_depend_only_on_seed_and_number():
    kind = faulty(lambda: None)
    share = Share("faulty", 0, 20, seed=3)
    assert kind.mutated(source(share, 7)) == kind.mutated(source(share, 7))
    assert kind.mutated(source(share, 7)) != kind.mutated(source(share, 8))


def test_choices_use_the_given_bytes_first():
    given = bytes(range(256)) * 2
    kind = faulty(lambda: None)
    assert kind.mutated(Choices(given)) == kind.mutated(Choices(given))
    assert Choices(b"\x00" * 8).random() == 0.0
    assert Choices(b"\xff" * 7).random() == 1.0 - 2.0**-53
    assert [Choices(bytes([value])).getrandbits(3) for value in (0, 0x20, 0xFF)] == [0, 1, 7]
    assert Choices(b"").getrandbits(9) == Random(0).getrandbits(9)


@pytest.mark.slow
def test_guided_inputs_are_tried_in_a_separate_process():
    pytest.importorskip("atheris")
    numbers = []
    tally = try_in_process(Share("geojson", 0, 200, guided=True, seed=1), numbers.append)
    assert (numbers, tally.inputs, tally.findings) == (list(range(200)), 200, {})
    assert 0 < tally.refused < 200


def test_a_dead_process_is_a_finding_and_is_replaced(monkeypatch, tmp_path):
    monkeypatch.setattr(isolation, "_begin", dies_at_3)
    tally = try_in_process(Share("dying", 0, 9, keep=tmp_path), lambda number: None)
    assert (tally.read, tally.findings) == (8, {3: "the process hung or ended (7)"})
    assert (tmp_path / "dying-0-3" / "a.json").read_text() == "3"
