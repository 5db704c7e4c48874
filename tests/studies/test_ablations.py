"""Each ablation is a valid experiment that changes one or two settings of one part."""

import msgspec
import pytest

from skystack.learning.experiment import load_experiment
from studies.ablations import ABLATIONS

VARIANTS = [
    (name, ablation)
    for name, ablations in ABLATIONS.items()
    for ablation in ablations
    if ablations[ablation]
]


@pytest.mark.parametrize(("name", "ablation"), VARIANTS)
def test_an_ablation_changes_one_or_two_settings(name, ablation):
    original, changed = (
        load_experiment(name, overrides) for overrides in ((), ABLATIONS[name][ablation])
    )
    assert original != changed
    parts = [
        part
        for part in ("task", "ppo", "pretraining")
        if getattr(original, part) != getattr(changed, part)
    ]
    assert len(parts) == 1
    original_values, changed_values = (
        msgspec.structs.asdict(getattr(each, parts[0])) for each in (original, changed)
    )
    assert 1 <= sum(original_values[key] != changed_values[key] for key in original_values) <= 2


@pytest.mark.parametrize("name", ABLATIONS)
def test_the_unchanged_experiment_is_the_first_row(name):
    assert next(iter(ABLATIONS[name].values())) == ()
