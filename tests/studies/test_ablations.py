"""Every ablation changes its experiment, and only what it says."""

import msgspec
import pytest

from skystack.learning.experiment import load_experiment
from studies.ablations import ABLATIONS

VARIANTS = [
    (name, words)
    for name, ablations in ABLATIONS.items()
    for words in ablations
    if ablations[words]
]


@pytest.mark.parametrize(("name", "words"), VARIANTS)
def test_an_ablation_is_another_valid_experiment(name, words):
    whole, changed = (load_experiment(name, way) for way in ((), ABLATIONS[name][words]))
    assert whole != changed
    parts = [
        part
        for part in ("task", "ppo", "pretraining")
        if getattr(whole, part) != getattr(changed, part)
    ]
    assert len(parts) == 1
    before, after = (msgspec.structs.asdict(getattr(each, parts[0])) for each in (whole, changed))
    assert 1 <= sum(before[key] != after[key] for key in before) <= 2


@pytest.mark.parametrize("name", ABLATIONS)
def test_the_experiment_itself_is_the_first_row(name):
    assert next(iter(ABLATIONS[name].values())) == ()
