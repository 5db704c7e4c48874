"""The rule for names; and no text in any file leads to a path outside the requested folder."""

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
from skystack.evaluation.summary import evaluation_folder
from skystack.io.names import MAX_NAME_CHARS, as_name, check_name
from skystack.learning import run as training
from skystack.learning.experiment import to_toml
from verification.inputs.audit import watched
from verification.inputs.texts import text_at, texts_in, with_text
from verification.inputs.untrusted_files import FORMATS

INVALID_NAMES = [
    *("", ".", "..", "../x", "a/b", "/abs", "a\\b", "C:\\x", "C:x", "a\0b", "\n", "a\n", " a"),
    *(
        ".hidden",
        "-rf",
        "größe",
        "e\u0301",
        "x" * (MAX_NAME_CHARS + 1),
        "\x1b[31m",
        "a:b",
        "a*",
        "~",
    ),
]


@pytest.mark.parametrize("text", INVALID_NAMES)
def test_rejects_invalid_names(text, tmp_path):
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
def test_derives_a_valid_name_from_any_text(text, name):
    assert as_name(text) == name


@pytest.mark.slow
@given(st.text(max_size=200))
def test_derived_names_are_valid(text):
    name = as_name(text)
    assert as_name(name) == name == check_name("it", name)
    assert Path("folder", f"{name}-s0").parent == Path("folder")
    assert len(os.fsencode(name)) <= MAX_NAME_CHARS


# The following tests replace each text in valid files of all formats.

LONG = "x" * 5000


def hostile(own, parent):
    """Paths that replace a text. There are valid files where they lead."""
    paths = ["../x", f"{parent}/x", "a/b", "a\0b", "..", "", ".", LONG, "C:\\x", "/dev/zero"]
    if len(own) < 100:
        paths += [f"../{own}", f"{parent}/{own}"]
    return paths


def text_paths(name, data):
    """The locations of texts in a file; only the first two of a list, of fixes and of packages."""
    members = defaultdict(list)
    for location in texts_in(name, data):
        for at, holder in enumerate(location[:-1]):
            known = members[location[: at + 1]]
            if location[at + 1] not in known:
                known.append(location[at + 1])
            many = isinstance(location[at + 1], int) or holder in ("fixes", "packages")
            if many and known.index(location[at + 1]) > 1:
                break
        else:
            yield location


def tree(folder):
    """The files of a folder and their sizes, without those in the requested folder."""
    return {
        str(path): path.stat().st_size
        for path in sorted(folder.rglob("*"))
        if folder / "requested" not in path.parents
    }


@pytest.fixture
def commands(monkeypatch, tmp_path):
    """Commands that make paths from the texts of a file; flights and training are shortened."""
    requested = tmp_path / "requested"
    recorded = {}

    def fly_here(*arguments):
        if not recorded:
            recorded["once"] = list(original_fly_here(*arguments))
        yield from recorded["once"]

    def train(experiment, seed, folder, *others):
        (folder / "config.toml").write_bytes(to_toml(experiment))
        raise InputError("training is skipped")

    original_fly_here = evaluate._fly_here
    monkeypatch.setattr(evaluate, "_fly_here", fly_here)
    monkeypatch.setattr(training, "train_experiment", train)
    options = ["--episodes", "1", "--out", str(requested / "output")]
    return {
        "experiment": ["train", str(requested / "experiment.toml")],
        "policy": ["evaluate", str(requested), *options],
        "onnx": ["evaluate", str(requested / "policy.onnx"), *options],
        "sb3": [
            "evaluate",
            str(requested / "policy.zip"),
            "--experiment",
            "lateral-undamped",
            *options,
        ],
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", [each for each in FORMATS if each != "checkpoint"])
def test_no_text_in_a_file_leads_out_of_its_folder(name, commands, tmp_path, monkeypatch, capsys):
    if name in ("onnx", "sb3"):
        pytest.importorskip({"onnx": "onnxruntime", "sb3": "stable_baselines3"}[name])
    kind, requested = FORMATS[name](), tmp_path / "requested"
    accepted = []
    for seed in {tuple(each): each for each in kind.seeds}.values():  # one for each set of files
        for folder in (tmp_path, requested):
            lay_out(seed, folder)
        monkeypatch.chdir(requested)
        kind.read(requested)  # loads lazy imports before the audit
        before, tried = tree(tmp_path), set()
        for part, data in seed.items():
            for case, changed in changed_texts(part, data, tmp_path, tried):
                (requested / part).write_bytes(changed)
                with watched(requested, writes=name in commands) as watch:
                    accepted.append(is_accepted(kind, requested))
                    if name in commands:
                        assert main(commands[name]) in (0, 2), case
                        stderr = capsys.readouterr().err
                        assert all(each.isprintable() for each in stderr.splitlines()), case
                assert (watch.found, tree(tmp_path)) == ([], before), case
                for produced in ("output", "runs"):
                    shutil.rmtree(requested / produced, ignore_errors=True)
            (requested / part).write_bytes(data)
    assert len(accepted) > 50
    assert False in accepted


def lay_out(files, folder):
    for part, data in files.items():
        (folder / part).parent.mkdir(parents=True, exist_ok=True)
        (folder / part).write_bytes(data)


def changed_texts(part, data, parent, tried):
    for location in text_paths(part, data):
        if part.endswith(".parquet") and location in tried:
            continue  # all tables of an evaluation have the same metadata
        texts = hostile(text_at(part, data, location), parent)
        tried.add(location)
        if location[-1] not in ("name", "experiment"):
            # A zip contains many texts, and its parts are never unpacked into files. The files in
            # subfolders of a run folder are also tested as formats of their own.
            few = part.endswith(".zip") or part.startswith(("train/", "evaluation/"))
            offset = len(tried) % len(texts)  # all texts are tried, but not at every location
            texts = (texts[offset:] + texts[:offset])[: 1 if few else 3]
        for text in texts:
            try:
                yield (part, location, text), with_text(part, data, location, text)
            except ValueError:  # the format cannot represent it
                continue


def is_accepted(kind, folder):
    """Whether a file can be read; if it is rejected, the error must be one line."""
    try:
        kind.read(folder)
    except InputError as error:
        line = str(error)
    else:
        return True
    assert line.isprintable()
    return False


def test_rejects_names_that_differ_only_in_case(tmp_path):
    """Some file systems ignore case, so the results of one run must not contain both."""
    kind = FORMATS["run-folder"]()
    lay_out(kind.seeds[0], tmp_path)
    results = json.loads((tmp_path / "results.json").read_bytes())
    (row,) = results["rows"]
    results["rows"].append(row | {"experiment": row["experiment"].upper()})
    (tmp_path / "results.json").write_text(json.dumps(results))
    with pytest.raises(InputError, match=r"rows: .* occurs twice"):
        kind.read(tmp_path)
