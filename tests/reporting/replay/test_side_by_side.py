"""Recordings side by side: which are accepted, and which of their scenarios are shown."""

import dataclasses
import shutil

import pytest

from skystack.errors import InputError
from skystack.reporting.replay.recording import read_replay
from skystack.reporting.replay.side_by_side import in_common, read_side_by_side


def test_rejects_different_scenarios(one_by_one, at_once, alone):
    first, other, different = map(read_replay, (one_by_one, at_once, alone))
    assert in_common((first, other)) == (first, other)
    with pytest.raises(InputError, match="scenario 0 of alone starts differently"):
        in_common((first, different))
    moved = dataclasses.replace(
        other.scenarios[0].aircraft[0], position_nm=other.scenarios[0].aircraft[0].position_nm + 0.2
    )
    aircraft = (moved, other.scenarios[0].aircraft[1])
    elsewhere = dataclasses.replace(other.scenarios[0], aircraft=aircraft)
    with pytest.raises(InputError, match="starts differently"):
        in_common((first, dataclasses.replace(other, scenarios=(elsewhere,))))
    later = dataclasses.replace(other.scenarios[0], number=7)
    with pytest.raises(InputError, match="no scenario in common"):
        in_common((first, dataclasses.replace(other, scenarios=(later,))))
    sector = dataclasses.replace(other.sector, name="another")
    with pytest.raises(InputError, match=r"is of sector another, .* of [\w-]+ \(allowed"):
        in_common((first, dataclasses.replace(other, sector=sector)))
    sector = dataclasses.replace(other.sector, separation_nm=4.0)
    with pytest.raises(
        InputError, match=f"have different sectors with the same name, {sector.name} "
    ):
        in_common((first, dataclasses.replace(other, sector=sector)))


def test_runs_with_the_same_name_are_titled_by_their_paths(evaluation, tmp_path):
    again = shutil.copytree(evaluation, tmp_path / evaluation.name)
    together = read_side_by_side((evaluation, again), scenarios=1)
    assert [replay.title for replay in together] == [str(evaluation), str(again)]


def test_escapes_folder_names_that_are_not_utf_8(evaluation, tmp_path):
    """On Linux, names are bytes, which need not be UTF-8."""
    odd = shutil.copytree(evaluation, tmp_path / "e\udcff")
    again = shutil.copytree(odd, tmp_path / "again" / odd.name)
    assert read_replay(odd, 1).title == r"e\udcff"
    titles = [replay.title for replay in read_side_by_side((odd, again), scenarios=1)]
    assert titles == [rf"{tmp_path}/e\udcff", rf"{tmp_path}/again/e\udcff"]


def test_omits_scenarios_of_only_one_run(evaluation):
    many, few = (read_replay(evaluation, count) for count in (5, 2))
    for replays in ((many, few), (few, many)):
        numbers = [[s.number for s in replay.scenarios] for replay in in_common(replays)]
        assert numbers == [[0, 1], [0, 1]]
