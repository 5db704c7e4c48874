"""Three kills of a training, a full disk and a read-only folder; the command makes more kills."""

import pytest

from verification.robustness.killed_trainings import SUBJECTS, survive


# The children execute another program at once, so JAX does not run in them after the fork.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_killed_training_gives_the_same_result(tmp_path, monkeypatch):
    monkeypatch.setenv("SKYSTACK_CACHE", str(tmp_path / "programs"))
    result = survive(SUBJECTS["training"], kills=3, seed=0, out=tmp_path)
    assert result.kills == 3
    assert result.trainings >= 1
