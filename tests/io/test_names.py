"""One rule for names; and no text in any file makes a path outside the requested folder."""

import json
import os
import shutil
from collections import defaultdict
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skystack.cli import main
from skystack.errors import InputError
from skystack.evaluation import evaluate
from skystack.evaluation.evaluate import evaluation_folder
from skystack.io.names import MOST_NAME, as_name, check_name
from skystack.learning import run as training
from skystack.learning.experiment import to_toml
from verification.inputs.audit import watched
from verification.inputs.texts import text_at, texts_in, with_text
from verification.inputs.untrusted_files import FORMATS

NO_NAMES = [
    *("", ".", "..", "../x", "a/b", "/abs", "a\\b", "C:\\x", "C:x", "a\0b", "\n", "a\n", " a"),
    *(".hidden", "-rf", "größe", "e\u0301", "x" * (MOST_NAME + 1), "\x1b[31m", "a:b", "a*", "~"),
]


@pytest.mark.parametrize("text", NO_NAMES)
def test_an_invalid_name_is_refused(text, tmp_path):
    with pytest.raises(InputError, match=r"^experiment is .* \(allowed: 1 to 80 of A-Z, a-z"):
        check_name("experiment", text)
    with pytest.raises(InputError, match=r"^the name of the experiment is "):
        evaluation_folder(tmp_path, text, 0, stacking=True)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("my model (2)", "my-model-2"),
        ("../../etc/passwd", "etc-passwd"),
        (".hidden", "hidden"),
        ("größe", "gr-e"),
        ("x" * 500, "x" * 80),
        ("///", "policy"),
        ("lateral-best.v2_a", "lateral-best.v2_a"),
    ],
)
def test_any_text_becomes_a_valid_name(text, name):
    assert as_name(text) == name


@given(st.text(max_size=200))
def test_a_derived_name_is_valid(text):
    name = as_name(text)
    assert as_name(name) == name == check_name("it", name)
    assert Path("folder", f"{name}-s0").parent == Path("folder")
    assert len(os.fsencode(name)) <= MOST_NAME


# What follows tries every text of a valid file of every format.

LONG = "x" * 5000


def hostile(own, parent):
    """Paths in the place of a text. Where they lead, a valid file lies."""
    paths = ["../x", f"{parent}/x", "a/b", "a\0b", "..", "", ".", LONG, "C:\\x", "/dev/zero"]
    if len(own) < 100:
        paths += [f"../{own}", f"{parent}/{own}"]
    return paths


def places(name, data):
    """The texts of a file; of many of a kind the first two: of a list, of fixes and packages."""
    members = defaultdict(list)
    for place in texts_in(name, data):
        for at, holder in enumerate(place[:-1]):
            known = members[place[: at + 1]]
            if place[at + 1] not in known:
                known.append(place[at + 1])
            many = isinstance(place[at + 1], int) or holder in ("fixes", "packages")
            if many and known.index(place[at + 1]) > 1:
                break
        else:
            yield place


def tree(folder):
    """What lies there, but in the folder that is asked for."""
    return {
        str(path): path.stat().st_size
        for path in sorted(folder.rglob("*"))
        if folder / "asked" not in path.parents
    }


@pytest.fixture
def used(monkeypatch, tmp_path):
    """What is done with a file after it was read, as far as a path is made of it."""
    asked = tmp_path / "asked"
    flown = {}

    def fly_here(*arguments):
        if not flown:
            flown["once"] = list(fly(*arguments))
        yield from flown["once"]

    def train(experiment, seed, folder, *others):
        (folder / "config.toml").write_bytes(to_toml(experiment))
        raise InputError("trained enough")

    fly = evaluate._fly_here
    monkeypatch.setattr(evaluate, "_fly_here", fly_here)
    monkeypatch.setattr(training, "train_experiment", train)
    few = ["--episodes", "1", "--out", str(asked / "here")]
    return {
        "experiment": ["train", str(asked / "experiment.toml")],
        "policy": ["evaluate", str(asked), *few],
        "onnx": ["evaluate", str(asked / "policy.onnx"), *few],
        "sb3": ["evaluate", str(asked / "policy.zip"), "--experiment", "lateral-undamped", *few],
    }


@pytest.mark.parametrize("name", [each for each in FORMATS if each != "checkpoint"])
def test_no_text_of_a_file_leads_out_of_the_folder(name, used, tmp_path, monkeypatch, capsys):
    if name in ("onnx", "sb3"):
        pytest.importorskip({"onnx": "onnxruntime", "sb3": "stable_baselines3"}[name])
    kind, asked = FORMATS[name](), tmp_path / "asked"
    read = []
    for seed in {tuple(each): each for each in kind.seeds}.values():  # one of each set of files
        for folder in (tmp_path, asked):
            lay_out(seed, folder)
        monkeypatch.chdir(asked)
        kind.read(asked)  # imports what it needs
        before, tried = tree(tmp_path), set()
        for part, data in seed.items():
            for what, changed in changed_texts(part, data, tmp_path, tried):
                (asked / part).write_bytes(changed)
                with watched(asked, writes=name in used) as watch:
                    read.append(is_read(kind, asked))
                    if name in used:
                        assert main(used[name]) in (0, 2), what
                        said = capsys.readouterr().err
                        assert all(each.isprintable() for each in said.splitlines()), what
                assert (watch.found, tree(tmp_path)) == ([], before), what
                for made in ("here", "runs"):
                    shutil.rmtree(asked / made, ignore_errors=True)
            (asked / part).write_bytes(data)
    assert len(read) > 50
    assert False in read


def lay_out(files, folder):
    for part, data in files.items():
        (folder / part).parent.mkdir(parents=True, exist_ok=True)
        (folder / part).write_bytes(data)


def changed_texts(part, data, parent, tried):
    for place in places(part, data):
        if part.endswith(".parquet") and place in tried:
            continue  # the tables of an evaluation have the same metadata
        texts = hostile(text_at(part, data, place), parent)
        tried.add(place)
        if place[-1] not in ("name", "experiment"):
            # A zip has many, and none of its parts is unpacked into a file; these files of a run
            # folder are formats of their own.
            alike = part.endswith(".zip") or part.startswith(("train/", "evaluation/"))
            turn = len(tried) % len(texts)  # all of them, but not in each place
            texts = (texts[turn:] + texts[:turn])[: 1 if alike else 3]
        for text in texts:
            try:
                yield (part, place, text), with_text(part, data, place, text)
            except ValueError:  # the format cannot say it
                continue


def is_read(kind, folder):
    """Or refused, in one line."""
    try:
        kind.read(folder)
    except InputError as error:
        line = str(error)
    else:
        return True
    assert line.isprintable()
    return False


def test_names_that_differ_only_in_case_are_refused(tmp_path):
    """On some systems; so they cannot both stand in the results of one run."""
    kind = FORMATS["run-folder"]()
    lay_out(kind.seeds[0], tmp_path)
    results = json.loads((tmp_path / "results.json").read_bytes())
    (row,) = results["rows"]
    results["rows"].append(row | {"experiment": row["experiment"].upper()})
    (tmp_path / "results.json").write_text(json.dumps(results))
    with pytest.raises(InputError, match=r"rows: .* occurs twice"):
        kind.read(tmp_path)
