"""A share of the mutated inputs in process: each is read, or refused in one clear line."""

import ctypes
from random import Random

import pytest

from skystack.errors import InputError
from tests.verification.dying import dies_at_3
from verification.inputs import isolation as tried_apart
from verification.inputs.isolation import Share, try_apart
from verification.inputs.trials import Choices, source, try_inputs
from verification.inputs.untrusted_files import FORMATS, Format

COUNT = 500
EXTRAS = {"onnx": ["onnx", "onnxruntime"], "sb3": ["stable_baselines3"]}


@pytest.mark.parametrize("name", FORMATS)
def test_mutated_files_are_read_or_refused_in_one_line(name, tmp_path):
    for package in EXTRAS.get(name, ()):
        pytest.importorskip(package)
    tally = try_inputs(FORMATS[name](), Share(name, 0, COUNT, seed=1), tmp_path)
    assert (tally.inputs, tally.findings) == (COUNT, {})
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
def test_anything_but_a_refusal_is_a_finding(error, found, tmp_path):
    share, folder = Share("faulty", 0, 20, keep=tmp_path / "kept"), tmp_path / "tried"
    folder.mkdir()
    tally = try_inputs(faulty(raising(error)), share, folder)
    assert tally.findings
    assert all(found in each for each in tally.findings.values())
    for number in tally.findings:  # what was read lies there
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


def test_what_a_library_of_another_language_writes_is_a_finding(tmp_path):
    """It raises no audit events; a link to a file is made without Python's knowledge here."""
    library = ctypes.CDLL(None)
    folder = tmp_path / "tried"
    folder.mkdir()

    def write():
        library.symlink(b"nowhere", bytes(folder / "link"))
        raise InputError("refused")

    tally = try_inputs(faulty(write), Share("faulty", 0, 20), folder)
    assert "wrote ['link']" in tally.findings.values()


def test_a_refusal_is_none(tmp_path):
    kind = faulty(raising(InputError("a is 2 (allowed: 1)")))
    tally = try_inputs(kind, Share("faulty", 0, 20), tmp_path)
    assert tally.refused > 0
    assert not tally.findings


def test_an_input_depends_on_the_seed_and_its_number_only():
    kind = faulty(lambda: None)
    share = Share("faulty", 0, 20, seed=3)
    assert kind.mutated(source(share, 7)) == kind.mutated(source(share, 7))
    assert kind.mutated(source(share, 7)) != kind.mutated(source(share, 8))


def test_choices_are_given_bytes_and_then_go_on():
    given = bytes(range(256)) * 2
    kind = faulty(lambda: None)
    assert kind.mutated(Choices(given)) == kind.mutated(Choices(given))
    assert Choices(b"\x00" * 8).random() == 0.0
    assert Choices(b"\xff" * 7).random() == 1.0 - 2.0**-53
    assert [Choices(bytes([value])).getrandbits(3) for value in (0, 0x20, 0xFF)] == [0, 1, 7]
    assert Choices(b"").getrandbits(9) == Random(0).getrandbits(9)


def test_guided_inputs_are_tried_apart():
    pytest.importorskip("atheris")
    heard = []
    tally = try_apart(Share("geojson", 0, 200, guided=True, seed=1), heard.append)
    assert (heard, tally.inputs, tally.findings) == (list(range(200)), 200, {})
    assert 0 < tally.refused < 200


def test_a_process_that_ends_is_a_finding_and_another_goes_on(monkeypatch, tmp_path):
    monkeypatch.setattr(tried_apart, "_begin", dies_at_3)
    tally = try_apart(Share("dying", 0, 9, keep=tmp_path), lambda number: None)
    assert (tally.read, tally.findings) == (8, {3: "the process hung or ended (7)"})
    assert (tmp_path / "dying-0-3" / "a.json").read_text() == "3"
