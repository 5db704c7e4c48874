"""Recorded hours, flown again with the same births and clearances."""

import pytest

from skystack.evaluation.stored import read_table, sector_of
from skystack.evaluation.traffic import evaluate_traffic, hours_folder
from skystack.evaluation.traffic_conditions import TrafficConditions
from verification.simulator.recorded_hours import BOUND_NM, agreement, main
from verification.simulator.recording import read_hour

CYCLES = 160
CATEGORY = TrafficConditions("category", cycles=CYCLES)


def recorded(out, conditions):
    """The folder of an hour under `rules`, which gives headings, fixes and levels."""
    evaluate_traffic("rules", conditions, out)
    return hours_folder(out, "rules", conditions)


def hour_of(folder, number=0):
    path = folder / "episodes.parquet"
    return sector_of(path, read_table(path, ("scenario",))), read_hour(folder, number)


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("hours"), CATEGORY)


@pytest.mark.slow
def test_our_own_hour_is_flown_again(ours):
    found = agreement(*hour_of(ours))
    assert found.flights > 20
    assert found.rows > 1000
    assert found.worst_nm < 0.001
    assert (found.wrong_levels, found.wrong_exits) == (0, 0)


@pytest.mark.slow
def test_bluebirds_hour_is_flown_again_in_our_simulator(tmp_path, capsys):
    pytest.importorskip("bluebird_dt")
    folder = recorded(tmp_path, CATEGORY._replace(platform="bluebird"))
    found = agreement(*hour_of(folder))
    assert found.flights > 20
    assert found.worst_nm < BOUND_NM / 4
    assert (found.wrong_levels, found.wrong_exits) == (0, 0)
    assert main([str(folder)]) == 0
    assert "1 hours: " in capsys.readouterr().out


@pytest.mark.slow
def test_differences_are_found(ours):
    """One clearance removed, one level changed, one exit a cycle later."""
    sector, hour = hour_of(ours)
    cycle, (first, *others) = next((c, told) for c, told in hour.sent.items() if len(told) > 1)
    fewer = hour._replace(sent=hour.sent | {cycle: others})
    assert agreement(sector, fewer).worst_nm > BOUND_NM
    flight = next(index for index, each in enumerate(hour.tracks) if each.gone_cycle is not None)
    tracks = list(hour.tracks)
    tracks[flight] = tracks[flight]._replace(gone_cycle=tracks[flight].gone_cycle + 1)
    higher = tracks[first[0]].fl.copy()
    higher[-1] += 1.0
    tracks[first[0]] = tracks[first[0]]._replace(fl=higher)
    found = agreement(sector, hour._replace(tracks=tracks))
    assert (found.wrong_levels, found.wrong_exits) == (1, 1)


def test_a_folder_without_hours_is_one_line(tmp_path, capsys):
    assert main([str(tmp_path)]) == 2
    assert "missing" in capsys.readouterr().err
