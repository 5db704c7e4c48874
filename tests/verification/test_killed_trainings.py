"""Three kills, a full disk and a read-only folder; the full count is the command's."""

import pytest

from verification.robustness.killed_trainings import SUBJECTS, survive


# Its children run another program at once: nothing of JAX goes on in them after the fork.
@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_training_that_is_killed_comes_to_the_same_end(tmp_path, monkeypatch):
    monkeypatch.setenv("SKYSTACK_CACHE", str(tmp_path / "programs"))
    done = survive(SUBJECTS["training"], kills=3, seed=0, out=tmp_path)
    assert done.kills == 3
    assert done.trainings >= 1
