"""A session line by line, and the verb from input to a recording that can be replayed."""

import io
import json
import sys

import pytest

from skystack.agents.sector_agents import SECTOR_AGENTS
from skystack.cli import main
from skystack.errors import InputError
from skystack.evaluation.stored import read_table
from skystack.live.hour import LiveHour
from skystack.live.situation import Conflict, Situation
from skystack.live.text_session import HELP, TextSession, aligned
from skystack.reporting.replay.recording import read_replay
from skystack.simulator.performance import TICKS_PER_FL

from .made import ADVISER, WORLD

CYCLES = 60


@pytest.fixture(scope="module")
def session():
    """A session in which some flights have arrived. Every one is advised to go direct."""
    hour = LiveHour(WORLD, seed=5)
    adviser = SECTOR_AGENTS[ADVISER](WORLD, 5)
    begun = TextSession(hour, adviser, CYCLES)
    begun.answer("40")
    return begun


@pytest.mark.slow
def test_shows_every_flight_with_what_it_is_cleared_to(session):
    header, *rows = session.answer("flights")
    assert header.split() == ["flight", "level", "exit", "heading", "kt", "next", "conflict"]
    assert [row.split()[0].strip("()") for row in rows] == list(session.hour.slots)
    name, slot = next(
        (name, slot) for name, slot in session.hour.slots.items() if session.hour.state.hears[slot]
    )
    level = float(session.hour.state.traffic.level_ticks[slot]) / TICKS_PER_FL
    wanted = 200 if level > 300 else 400
    (answer,) = session.answer(f"{name} maintain {wanted}")
    assert answer == f'"{"climb" if wanted > level else "descend"} FL{wanted}, {name}"'
    row = next(row for row in session.answer("flights")[1:] if row.startswith(f"{name} "))
    assert f"{level:03.0f} to {wanted}" in row


def test_an_empty_line_flies_a_cycle_and_says_the_time(session):
    cycle = session.hour.cycle
    *_, last = session.answer("\n")
    assert session.hour.cycle == cycle + 1
    seconds = 6 * (cycle + 1)
    count = len(session.hour.slots)
    assert last.startswith(f"{seconds // 60}:{seconds % 60:02d} {count} flight")


def test_advice_is_shown_and_only_then_transmitted(session):
    with pytest.raises(InputError, match=r"nothing to accept"):
        session.answer("accept")
    sent = len(session.hour._recorder.sent)
    proposed = session.answer("advise")
    assert all("resume own navigation direct" in each for each in proposed)
    assert len(session.hour._recorder.sent) == sent
    read_back = session.answer("accept")
    assert [each.strip('"').rpartition(", ")[2] for each in read_back] == [
        each.split()[0] for each in proposed
    ]
    assert len(session.hour._recorder.sent) == sent + len(proposed) > sent


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("0", r"0 cycles \(allowed: 1 to \d+, the rest of the session\)"),
        ("999999999999", r"999999999999 cycles \(allowed: 1 to"),
        ("fly", "unknown callsign 'fly'"),
    ],
)
def test_refuses_what_it_does_not_understand(session, line, message):
    with pytest.raises(InputError, match=message):
        session.answer(line)


def test_conflicts_are_pairs_that_will_lose_separation():
    """Two flights on one route at one level, the second put 6 NM behind the first, and faster."""
    hour = LiveHour(WORLD, seed=5)
    for _ in range(40):
        hour.advance()
    (one, first), (other, second) = list(hour.slots.items())[:2]
    traffic = hour.state.traffic
    position, speed = traffic.position_nm.copy(), traffic.airspeed_factor.copy()
    names = ("heading_deg", "cleared_heading_deg", "flown_heading_deg", "level_ticks")
    names = (*names, "cleared_level_ticks", "flown_level_ticks", "route", "next_fix")
    values = {name: getattr(traffic, name).copy() for name in names}
    for each in values.values():
        each[second] = each[first]
    for slot in hour.slots.values():
        position[slot] = (1000.0 + 100.0 * slot, 0.0)  # everyone else is far away
    values["heading_deg"][[first, second]] = 0.0
    values["cleared_heading_deg"][[first, second]] = 0.0
    values["flown_heading_deg"][[first, second]] = 0.0
    position[first], position[second] = (0.0, 0.0), (0.0, -6.0)
    ground_kt = traffic.ground_speed_kt.copy()
    ground_kt[first], ground_kt[second] = 400.0, 430.0
    hour.state = hour.state._replace(
        traffic=traffic._replace(
            position_nm=position, airspeed_factor=speed, ground_speed_kt=ground_kt, **values
        )
    )
    (found,) = [each for each in Situation(hour).conflicts() if one in each.callsigns]
    assert set(found.callsigns) == {one, other}
    assert found.in_s == pytest.approx(3600.0 * 1.0 / 30.0, abs=15.0)  # 1 NM at 30 kt
    assert isinstance(found, Conflict)


def test_columns_are_aligned():
    assert aligned([("a", "bc"), ("def", "")]) == ["a    bc", "def"]


class Input:
    """Standard input with some lines, not a terminal."""

    def __init__(self, data):
        self.buffer = io.BytesIO(data)

    def isatty(self):
        return False


@pytest.mark.slow
def test_the_verb_flies_what_is_typed_and_records_it(tmp_path, capsys, monkeypatch):
    lines = b"30\n\xff\xff heading\nAC1 fly heading 270\n5\nquit\nAC1 not read any more\n"
    monkeypatch.setattr(sys, "stdin", Input(lines))
    out = tmp_path / "recordings"
    assert (
        main(["session", "--text", "600", "--seed", "5", "--cycles", "60", "--out", str(out)]) == 0
    )
    found = capsys.readouterr()
    assert "refused: unknown callsign" in found.err
    assert '"turn' in found.out or '"fly heading 270, AC1"' in found.out
    (folder,) = out.iterdir()
    assert folder.name == "session-traffic-600-seed-5"
    assert f"written: {folder}" in found.err
    assert json.loads((folder / "row.json").read_text())["agent"] == "session"
    (issued,) = read_table(folder / "clearances.parquet", ("callsign", "cycle")).to_pylist()
    assert issued == {"callsign": "AC1", "cycle": 30}
    replay = read_replay(folder)
    assert replay.scenarios[0].cycles == 35
    assert replay.title.startswith("session, 600 flights/h")


@pytest.mark.slow
def test_a_clearance_after_the_last_cycle_is_not_in_the_recording(tmp_path, monkeypatch):
    lines = b"30\nAC1 fly heading 270\n1\nAC1 fly heading 280\nquit\n"
    monkeypatch.setattr(sys, "stdin", Input(lines))
    out = tmp_path / "recordings"
    assert main(["session", "--text", "600", "--seed", "5", "--out", str(out)]) == 0
    (folder,) = out.iterdir()
    issued = read_table(folder / "clearances.parquet", ("value",)).to_pylist()
    assert issued == [{"value": 270}]


def test_the_verb_says_at_once_that_nothing_can_be_written(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", Input(b"1\nquit\n"))
    (tmp_path / "file").touch()
    assert main(["session", "--text", "--out", str(tmp_path / "file")]) == 2
    found = capsys.readouterr()
    assert "0:06" not in found.out
    assert "file" in found.err


def test_the_verb_refuses_a_seed_for_a_scenario_file(capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", Input(b""))
    assert main(["session", "--text", "examples/head-on.json", "--seed", "4"]) == 2
    assert "head-on.json with seed 4 (allowed: no seed" in capsys.readouterr().err


def test_lines_of_the_help_fit_a_terminal():
    assert max(map(len, HELP)) < 80


def test_the_verb_refuses_an_unknown_adviser(capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", Input(b""))
    assert main(["session", "--text", "--adviser", "serch"]) == 2
    assert "unknown agent 'serch'; did you mean 'search'?" in capsys.readouterr().err
