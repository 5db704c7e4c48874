"""Which figures a run has, and which scenario they show."""

import json
import xml.etree.ElementTree as ET

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skystack.errors import InputError
from skystack.reporting.figures import typical_scenario, write_figures
from skystack.reporting.results import read_run

ROWS = ["lateral-undamped-plain", "lateral-plain", "lateral-stacked", "do-nothing-plain"]
EXPECTED = {
    "trajectories-lateral",
    "histograms-lateral",
    "success-lateral",
    *(f"trajectory-{row}" for row in ROWS),
    *(f"histogram-{row}" for row in ROWS),
    "learning-lateral",
    "learning-lateral-undamped",
}


def set_episodes(run, clearances, success):
    path = run / "evaluation/lateral-s0-skystack-stacked/episodes.parquet"
    table = pa.table(
        {
            "scenario": np.arange(len(clearances), dtype=np.int32),
            "clearances": np.array(clearances, dtype=np.int32),
            "success": np.array(success),
            "min_separation_nm": np.full(len(success), np.inf),
        }
    )
    pq.write_table(table, path)


def rows_of(run):
    whole = read_run(run)
    return whole, whole.results.rows


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


@pytest.mark.parametrize(
    ("clearances", "success", "typical"),
    [
        ([2, 9, 6, 5], [True] * 4, 3),  # the mean is 5.5; the first of two equally near
        ([2, 9, 6, 5], [True, True, True, False], 2),
        ([2, 9, 6, 5], [False, True, False, False], 1),
        ([2, 9, 6, 5], [False] * 4, 3),
    ],
)
def test_the_scenario_shown_is_a_typical_success(run, clearances, success, typical):
    set_episodes(run, clearances, success)
    shown = typical_scenario(*rows_of(run))
    nearest = {2, 3} if typical == 3 else {typical}
    assert shown in nearest


def test_a_run_that_flew_nothing_says_so(run):
    stored = json.loads((run / "results.json").read_text())
    (run / "results.json").write_text(json.dumps(stored | {"rows": [stored["rows"][0]]}))
    (run / "evaluation/lateral-s0-skystack-stacked/episodes.parquet").unlink()
    with pytest.raises(InputError, match=r"episodes\.parquet: missing"):
        write_figures(run)
