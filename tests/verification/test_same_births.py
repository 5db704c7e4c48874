"""Controllers make the same decisions in BluebirdDT and in skystack, on the same births."""

import json
import shutil

import pytest

from skystack.evaluation.flight_school import fly_flight_school
from skystack.evaluation.traffic_conditions import TrafficConditions
from verification.simulator.same_births import Pair, in_words, main, relative

CYCLES = 80


@pytest.mark.slow
@pytest.mark.parametrize("agent", ["sector-control", "rules"])
def test_a_controller_makes_the_same_decisions_in_bluebirddt(tmp_path, capsys, one_process, agent):
    pytest.importorskip("bluebird_dt")
    conditions = TrafficConditions("category", cycles=CYCLES, platform="bluebird")
    folder = fly_flight_school(agent, conditions, range(5, 6), tmp_path).folder
    assert main([str(folder)]) == 0
    printed = capsys.readouterr().out
    assert f"the same decisions for {CYCLES} cycles" in printed
    assert float(printed.split("at most ")[1].split()[0]) < 0.001


@pytest.fixture(scope="module")
def hour(tmp_path_factory):
    """A folder with a short hour in skystack."""
    conditions, out = TrafficConditions("category", cycles=40), tmp_path_factory.mktemp("hours")
    return fly_flight_school("rules", conditions, range(1), out).folder


@pytest.mark.slow
def test_another_controller_decides_differently(hour, tmp_path, capsys):
    """The row of an hour under `rules` names `own-navigation`."""
    folder = shutil.copytree(hour, tmp_path / "hour")
    row = folder / "row.json"
    row.write_text(row.read_text().replace('"rules"', '"own-navigation"'))
    assert main([str(folder)]) == 0
    cycles = int(capsys.readouterr().out.split("the same decisions for ")[1].split()[0])
    assert cycles < 10


def test_means_and_their_interval():
    """Differences of 0, 30 and 60 s: mean 30, standard error 17.32, t 4.303."""
    ours = ((600.0, 100, 0.0), (630.0, 20, 0.02), (660.0, 60, 0.01))
    pairs = [Pair(600.0, *each) for each in ours]
    assert relative(pairs) == pytest.approx(0.05)
    text = in_words(pairs)
    assert "+5.0 % (95 % confidence interval: -7.4 to +17.4 %)" in text
    assert "equal scores: 1; medians: the same decisions for 60 cycles" in text
    assert text.endswith("positions then at most 0.0100 NM apart")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed_numbers": None}, "not the row of skystack flight-school"),
        ({"lax_s_by_hour": [6.0, 6.0]}, "not the row of skystack flight-school"),
        ({"uncertainty": True}, "only random traffic without uncertainty"),
        ({"lax_s_by_hour": [0.0]}, "all lax scores are 0"),
        ({"seed_numbers": [7]}, "has no hour 7"),
    ],
)
def test_hours_that_cannot_be_flown_again_are_refused_in_one_line(
    hour, tmp_path, capsys, changes, message
):
    shutil.copytree(hour, tmp_path / "hour")
    row = tmp_path / "hour" / "row.json"
    row.write_text(json.dumps(json.loads(row.read_text()) | changes))
    assert main([str(row.parent)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line


def test_a_folder_without_a_row_is_refused_in_one_line(tmp_path, capsys):
    assert main([str(tmp_path)]) == 2
    assert "row.json" in capsys.readouterr().err
