"""Evaluations of one policy in several simulators: their rows, agreement and failures."""

from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pytest

from skystack.errors import PlatformError
from skystack.evaluation import cross_platform
from skystack.evaluation.cross_platform import evaluate_on_platforms
from skystack.evaluation.evaluate import Evaluation
from skystack.policies.shipped import find_policy

POLICY, FOLDER = find_policy("lateral"), Path("folder")


def clearances(values):
    """One clearance per scenario, with the given value."""
    return pa.table(
        {
            "scenario": list(values),
            "cycle": [3] * len(values),
            "callsign": ["AC1"] * len(values),
            "kind": ["heading"] * len(values),
            "value": list(values.values()),
        }
    )


def evaluation_of(conditions, values, failed=None):
    row = {"platform": conditions.platform, "stacking": conditions.stacking}
    return Evaluation(row, pa.table({"scenario": list(values)}), clearances(values), failed or {})


def fake_evaluate(policy, conditions, out, on_scenario=None):
    """Replaces `evaluate`: in BluebirdDT one scenario of four has another clearance and one fails;
    BlueSky does not start with stacking."""
    assert policy is POLICY
    assert conditions.episodes == 4
    same = {0: 10, 1: 20, 2: 30, 3: 40}
    if conditions.platform == "skystack":
        assert out is None
        return evaluation_of(conditions, same)
    on_scenario(4)
    assert out == FOLDER
    if conditions.platform == "bluesky" and conditions.stacking:
        raise PlatformError("it does not start")
    if conditions.platform == "bluesky":
        return evaluation_of(conditions, same)
    return evaluation_of(conditions, {0: 10, 2: 30, 3: 50}, {1: "took more than 2 s"})


def test_every_platform_is_compared_with_ours(monkeypatch):
    monkeypatch.setattr(cross_platform, "evaluate", fake_evaluate)
    progress = []

    @contextmanager
    def count(name, episodes):
        yield lambda done: progress.append((name, episodes, done))

    found = evaluate_on_platforms(POLICY, ["bluebird", "bluesky"], 4, FOLDER, count)
    rows = [(row["stacking"], row["platform"], row.get("same_clearances_rate")) for row in found[0]]
    two_thirds = pytest.approx(2 / 3)
    assert rows == [
        (False, "skystack", None),
        (False, "bluebird", two_thirds),
        (False, "bluesky", 1.0),
        (True, "skystack", None),
        (True, "bluebird", two_thirds),
    ]
    assert found.failed == [
        "lateral bluebird: scenario 1 took more than 2 s",
        "lateral bluebird: scenario 1 took more than 2 s",
        "lateral bluesky: it does not start",
    ]
    names = ["lateral bluebird", "lateral bluesky"] * 2
    assert progress == [(name, 4, 4) for name in names]
