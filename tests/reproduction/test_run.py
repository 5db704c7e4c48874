"""`reproduce` on other platforms: plain and stacked rows are added to the results."""

import json
import shutil
from contextlib import nullcontext

import pytest

from skystack.policies.shipped import SHIPPED
from skystack.reproduction.plan import make_plan
from skystack.reproduction.run import run_platforms


@pytest.mark.slow
@pytest.mark.usefixtures("one_process")
def test_first_seed_is_flown_on_other_platforms(tmp_path):
    pytest.importorskip("bluebird_dt")
    plan = make_plan(["lateral"], 1, 3, tmp_path, False, "command", ["bluebird", "bluebird"])
    best = plan.experiments[-1]
    plan = plan.__class__(**vars(plan) | {"experiments": (best,)})
    shutil.copytree(SHIPPED / best.name, tmp_path / "train" / f"{best.name}-s0")
    results = {"rows": [], "wall_s": 100.0}
    assert run_platforms(plan, results, lambda name, total: nullcontext(lambda done: None)) == []
    written = json.loads((tmp_path / "results.json").read_text())
    assert written["wall_s"] > 100.0
    rows = written["platforms"]
    assert [(row["platform"], row["stacking"], row["episodes"]) for row in rows] == [
        ("skystack", False, 3),
        ("bluebird", False, 3),
        ("skystack", True, 3),
        ("bluebird", True, 3),
    ]
    assert all("same_clearances_rate" in row for row in rows[1::2])
    assert rows[3]["clearances_mean"] == pytest.approx(rows[2]["clearances_mean"], abs=0.5)
    assert (tmp_path / "evaluation" / f"{best.name}-s0-bluebird-stacked").is_dir()
