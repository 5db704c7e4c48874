"""Two reproductions are the same if they differ only in fields that describe the run."""

import json

import pytest

from verification.robustness.same_result import contents


def write_run(folder, wall_s=1.0, loss=0.5, weights=b"weights"):
    training = folder / "train" / "lateral-s0"
    training.mkdir(parents=True)
    lines = [{"update": number, "loss": loss, "wall_s": wall_s * number} for number in (1, 2)]
    (training / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (training / "policy.safetensors").write_bytes(weights)
    (training / "training.json").write_text(json.dumps({"hashes": wall_s}))
    summary = {"steps": 512, "wall_s": wall_s, "steps_per_s": 512 / wall_s}
    results = {"train": [summary], "wall_s": wall_s, "machine": f"{wall_s} cores"}
    (folder / "results.json").write_text(json.dumps(results))
    return contents(folder)


@pytest.mark.parametrize(
    ("other", "differs"),
    [
        ({"wall_s": 2.0}, []),
        ({"loss": 0.25}, ["train/lateral-s0/metrics.jsonl"]),
        ({"weights": b"others"}, ["train/lateral-s0/policy.safetensors"]),
    ],
)
def test_ignores_times_and_the_machine(tmp_path, other, differs):
    first, second = write_run(tmp_path / "first"), write_run(tmp_path / "second", **other)
    assert len(first) == 3
    assert [name for name in first if first[name] != second[name]] == differs
