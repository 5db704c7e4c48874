"""The updates of an hour say what was flown, and can be taken back."""

import numpy as np
import pytest

from skystack.evaluation.hour_scores import score
from skystack.evaluation.losses import FlightPath, losses
from skystack.live.clearance_text import parse_clearance
from skystack.live.history import History
from skystack.simulator.performance import TICKS_PER_FL

from .made import WORLD, begun_hour, on_frequency

CYCLES = 120


@pytest.fixture(scope="module")
def flown():
    """A history of an hour in which a clearance was issued."""
    hour = begun_hour(seed=3, flights=0)
    history = History(WORLD.simulator)
    for number in range(1, CYCLES + 1):
        cycle = hour.advance()
        history.add_cycle(number, cycle, hour.slots)
        if number == 60:
            told = hour.transmission_for(
                parse_clearance(f"{on_frequency(hour)[0]} left 20 degrees", hour.slots)
            )
            issued = hour.transmit(told)
            history.add_clearance(hour.state, told, issued, "you")
    return hour, history


def cycles_of(history):
    return [each for each in history.updates if "cycle" in each]


def test_every_flight_is_born_once_and_then_has_a_row_in_every_cycle(flown):
    hour, history = flown
    born, rows = [], []
    for update in cycles_of(history):
        born += update["born"]
        rows.append([row[0] for row in update["flights"]])
        assert rows[-1] == sorted(rows[-1])
        assert rows[-1][-1:] <= [len(born) - 1]
    assert [each["callsign"] for each in born if each["callsign"] in hour.slots] == sorted(
        hour.slots, key=lambda name: hour.state.arrivals.flight[hour.slots[name]]
    )
    for number in range(len(born)):
        present = [number in row for row in rows]
        assert np.diff(np.flatnonzero(present)).tolist() == [1] * (sum(present) - 1)


def test_flights_that_are_there_at_the_start_have_a_row_before_the_first_cycle():
    hour = begun_hour(seed=3, flights=3)
    history = History(WORLD.simulator)
    history.add_start(hour.state, hour.slots)
    (start,) = history.updates
    assert start["cycle"] == 0
    assert {each["callsign"] for each in start["born"]} == hour.slots.keys()
    assert (start["gone"], start["losses"]) == ([], [])
    rows = {row[0]: row for row in start["flights"]}
    for slot in hour.slots.values():
        row = rows[int(hour.state.arrivals.flight[slot])]
        np.testing.assert_allclose(row[1:3], hour.state.traffic.position_nm[slot], atol=1e-4)
    history.add_cycle(1, hour.advance(), hour.slots)
    assert not {each["callsign"] for each in history.updates[1]["born"]} & {
        each["callsign"] for each in start["born"]
    }


def test_no_update_is_added_before_the_first_cycle_without_flights():
    hour, history = begun_hour(flights=0), History(WORLD.simulator)
    history.add_start(hour.state, hour.slots)
    assert history.updates == []


def test_the_last_rows_are_the_state(flown):
    hour, history = flown
    traffic = hour.state.traffic
    rows = {row[0]: row for row in cycles_of(history)[-1]["flights"]}
    for slot in hour.slots.values():
        row = rows[int(hour.state.arrivals.flight[slot])]
        np.testing.assert_allclose(row[1:3], traffic.position_nm[slot], atol=1e-4)
        assert row[3] == pytest.approx(float(traffic.level_ticks[slot]) / TICKS_PER_FL, abs=1e-3)
        assert row[4] == pytest.approx(float(traffic.heading_deg[slot]), abs=0.01)


def test_losses_and_exits_are_those_of_the_recording(flown):
    hour, history = flown
    recorded = hour.recorded()
    scores = score(WORLD.sector, recorded)
    paths = [
        FlightPath(*_path(recorded, row.flight, row.birth), begins=row.birth)
        for row in scores.flights
    ]
    expected = set()
    for loss in losses(WORLD.sector, paths):
        expected |= {(loss.first, loss.second, row + 1) for row in range(loss.begins, loss.ends)}
    found = {
        (first, second, update["cycle"])
        for update in cycles_of(history)
        for first, second, _ in update["losses"]
    }
    assert len(expected) > 5
    assert found == expected
    gone = {number: how for update in cycles_of(history) for number, how in update["gone"]}
    assert gone == {
        row.flight: "correct" if row.correct else "wrong_exit_level" if row.exited else "excursion"
        for row in scores.flights
        if row.gone is not None
    }


def _path(recorded, flight, birth):
    """Positions and levels of a flight: before its first cycle, then after each cycle."""
    cycle, slot = np.nonzero(recorded.flight == flight)
    before = recorded.before_nm[birth, slot[0]], recorded.before_level_ticks[birth, slot[0]]
    position = np.vstack([before[0][None], recorded.traffic.position_nm[cycle, slot]])
    level = np.append(before[1], recorded.traffic.level_ticks[cycle, slot]) / TICKS_PER_FL
    return position.astype(np.float64), level.astype(np.float64)


def test_a_clearance_has_its_words_and_what_is_cleared(flown):
    _, history = flown
    (update,) = [each for each in history.updates if "clearances" in each]
    (clearance,) = update["clearances"]
    assert (update["by"], clearance["cycle"], clearance["kind"]) == ("you", 60, "heading")
    assert clearance["text"].endswith(f"turn left heading {clearance['value'] or 360:03d}")
    assert update["cleared_heading"] % 360 == clearance["value"] % 360


def test_going_back_takes_updates_back_and_changes_the_epoch(flown):
    _, history = flown
    epoch, before = history.epoch, list(history.updates)
    history.rewind(60)  # the clearance was issued after cycle 60
    assert history.updates == before[:60]
    assert history.epoch != epoch
    history.rewind(0)
    assert history.updates == []
