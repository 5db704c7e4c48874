"""Which figures a run has."""

import json
import xml.etree.ElementTree as ET

import pytest

from skystack.errors import InputError
from skystack.reporting.figures import write_figures
from skystack.reporting.report import write_report
from tests.reporting.conftest import write_run

ROWS = ["lateral-undamped-plain", "lateral-plain", "lateral-stacked", "do-nothing-plain"]
EXPECTED = {
    "loop",
    "sector",
    "routes",
    "trajectories-lateral",
    "histograms-lateral",
    "success-lateral",
    *(f"trajectory-{row}" for row in ROWS),
    *(f"histogram-{row}" for row in ROWS),
    "learning-lateral",
    "learning-lateral-undamped",
}


def test_every_figure_is_there_in_both_formats(reported):
    written = {path.name for path in (reported / "figures").iterdir()}
    assert written == {f"{name}.{kind}" for name in EXPECTED for kind in ("png", "svg")}


def test_figures_are_whole_and_say_nothing_of_this_machine(reported):
    for path in (reported / "figures").iterdir():
        data = path.read_bytes()
        assert str(reported).encode() not in data
        if path.suffix == ".svg":
            assert ET.fromstring(data).tag.endswith("svg")
        else:
            assert data.startswith(b"\x89PNG")
            assert data.endswith(b"IEND\xaeB`\x82")


def test_few_actions_and_many_are_set_beside_each_other_where_both_were_trained(tmp_path):
    rows = [("avoidance", True), ("avoidance-large", False)]
    run = write_run(tmp_path / "run", rows=rows, seeds=(0,), scenarios=2)
    report = write_report(run).read_text()
    stems = {path.stem for path in (run / "figures").iterdir()}
    assert {"convergence-avoidance", "separations-avoidance", "trajectories-avoidance"} <= stems
    assert "The small and the large action space side by side" in report


def test_a_run_that_flew_nothing_says_so(run):
    stored = json.loads((run / "results.json").read_text())
    (run / "results.json").write_text(json.dumps(stored | {"rows": [stored["rows"][0]]}))
    (run / "evaluation/lateral-s0-skystack-stacked/episodes.parquet").unlink()
    with pytest.raises(InputError, match=r"episodes\.parquet: missing"):
        write_figures(run)
