"""The phases of a training run (pre-training and training), and their compiled programs."""

from concurrent.futures import Future
from functools import partial

import jax
import numpy as np
import pytest

from skystack.learning import ppo
from skystack.learning.collection import TrainState
from skystack.learning.experiment import load_experiment
from skystack.learning.phases import compiled_updates, phases, run_updates
from skystack.learning.seeds import training_key
from skystack.tasks.registry import build_training_task

SMALL = ("ppo.environments=8", "ppo.steps=32", "ppo.minibatch=64", "ppo.total_steps=1024")


def experiment_with(*changes):
    return load_experiment("lateral", SMALL + changes)


@pytest.mark.parametrize(
    ("pretraining", "first", "starts"),
    [
        (None, 0, {0: "later"}),
        (None, 2, {2: "later"}),
        (512, 0, {0: "before", 2: "later"}),
        (512, 1, {1: "before", 2: "later"}),
        (512, 2, {2: "later"}),  # resumed after pre-training
        (513, 0, {0: "before", 3: "later"}),  # rounded up to whole updates
        (1024, 0, {0: "before"}),  # pre-training only
        (1000, 3, {3: "before"}),
        (512, 4, {}),  # all updates are done
        (None, 4, {}),
    ],
)
def test_each_phase_starts_at_its_update(pretraining, first, starts):
    changes = ["task.reward.damping=0.25"]
    if pretraining is not None:
        changes += [f"pretraining.steps={pretraining}", "pretraining.reward.damping=5.0"]
    experiment = experiment_with(*changes)
    task = build_training_task(experiment.task)
    found = phases(experiment, task, first)
    names = {0.25: "later", 5.0: "before"}
    assert {at: names[each.settings.reward.damping] for at, each in found.items()} == starts


def recording_program(name):
    """The program of a phase, which only records the phase's name."""
    program = Future()
    program.set_result(lambda learner: (learner._replace(key=(*learner.key, name)), {"is": name}))
    return program


def test_each_update_runs_the_program_of_its_phase():
    """Of four updates one is done; the phases start after the first and after the third."""
    settings = experiment_with().ppo
    assert settings.updates == 4
    learner = TrainState(*[None] * len(TrainState._fields))._replace(updates=1, key=())
    trained = list(
        run_updates(
            {1: recording_program("before"), 3: recording_program("later")}, settings, learner
        )
    )
    assert [number for number, _, _ in trained] == [2, 3, 4]
    assert [measured["is"] for _, _, measured in trained] == ["before", "before", "later"]
    assert trained[-1][1].key == ("before", "before", "later")


@pytest.mark.slow
def test_program_compiled_in_a_thread_is_the_same():
    """The programs compiled in a thread give the results of those compiled by the caller."""
    experiment = experiment_with("ppo.total_steps=512")
    task, settings = build_training_task(experiment.task), experiment.ppo
    init = jax.jit(partial(ppo.init, task, settings))
    like, learner = jax.eval_shape(init, training_key(0)), init(training_key(0))
    with compiled_updates({0: task}, settings, like) as updates:
        trained = list(run_updates(updates, settings, learner))
    assert [number for number, _, _ in trained] == [1, 2]
    update = jax.jit(lambda learner: ppo.update(task, settings, learner))
    expected, _ = update(update(learner)[0])
    for ours, theirs in zip(
        jax.tree.leaves(trained[-1][1].parameters),
        jax.tree.leaves(expected.parameters),
        strict=True,
    ):
        np.testing.assert_array_equal(ours, theirs)
