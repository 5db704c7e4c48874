"""`skystack export` of scenarios: files for BlueSky, from scenario files and evaluations."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from skystack.errors import InputError
from skystack.evaluation.stored import stored_scenario
from skystack.export.scenario import export_scenario
from skystack.platforms.flight import fly_scenario
from skystack.platforms.own import Skystack
from tests.export.conftest import EPISODES, evaluation_of
from tests.scenarios import EXAMPLES


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["lateral-best", "vertical"])
def test_a_stored_scenario_flies_the_same_again(out, policy):
    folder = evaluation_of(out, policy)
    for number in range(EPISODES):
        check_flies_the_same(folder, number)


def check_flies_the_same(folder, number):
    scenario = stored_scenario(folder, number)
    table = pq.read_table(folder / "trajectories.parquet", filters=[("scenario", "=", number)])
    reports = fly_scenario(Skystack(), scenario).reports
    not_exited = [status not in {"exited"} for status in table["status"].to_pylist()]
    for name in ("lat", "lon", "fl", "heading_deg", "cleared_heading_deg"):
        flown = np.stack([getattr(report, name) for report in reports]).reshape(-1)
        # Stored positions are float32, and exited aircraft no longer move.
        np.testing.assert_allclose(flown[not_exited], np.array(table[name])[not_exited], atol=2e-4)


def test_exports_an_evaluated_scenario_as_a_bluesky_file(folder, tmp_path):
    target = tmp_path / "one.scn"
    export_scenario(folder, 1, target)
    lines = target.read_text().splitlines()
    issued = pq.read_table(folder / "clearances.parquet", filters=[("scenario", "=", 1)])
    headings = [line for line in lines if ">HDG " in line]
    assert len(headings) == issued.num_rows > 0
    for line, clearance in zip(headings, issued.to_pylist(), strict=True):
        minutes, seconds = divmod(6 * clearance["cycle"], 60)
        clock = f"00:{minutes:02d}:{seconds:02d}.00"
        assert line == f"{clock}>HDG {clearance['callsign']} {clearance['value']:03d}"
    assert sum(">CRE AC" in line and " B752 " in line for line in lines) == 2


def test_a_rejected_export_leaves_no_file(folder, tmp_path):
    target = tmp_path / "out.scn"
    with pytest.raises(InputError, match="has no scenario 3"):
        export_scenario(folder, 3, target)
    with pytest.raises(InputError, match="only with the folder"):
        export_scenario(EXAMPLES / "head-on.json", 3, target)
    with pytest.raises(InputError, match=r"reference.json: turn is 'right' in cycle 40"):
        export_scenario(EXAMPLES / "reference.json", None, target)
    with pytest.raises(InputError, match=r"trajectories\.parquet: missing"):
        export_scenario(tmp_path, None, target)
    assert list(tmp_path.iterdir()) == []
