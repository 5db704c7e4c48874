"""Scores of flown hours, on made hours whose scores are known."""

import numpy as np
import pytest

from skystack.agents.transmission import Transmission
from skystack.airspace.xplus import x_plus
from skystack.evaluation.hour_scores import score, summary
from skystack.evaluation.hours import Hour, Sent
from skystack.simulator.arrivals import FREE
from skystack.simulator.traffic import Traffic, ticks

SECTOR = x_plus()
CYCLES, SLOTS = 30, 3
FIELDS = len(Traffic._fields) - len(Traffic._field_defaults)


def hour(paths, sent=(), **events):
    """An hour from each slot's flight, first cycle, positions and levels.

    Positions and levels have one more row than cycles: the first is that of birth.
    """
    shape = (CYCLES, SLOTS)
    values = {
        "flight": np.full(shape, FREE),
        "candidate": np.zeros(shape, dtype=int),
        "before_nm": np.zeros((*shape, 2)),
        "position_nm": np.zeros((*shape, 2)),
        "before_level_ticks": np.zeros(shape),
        "level_ticks": np.zeros(shape),
        "exit_level_ticks": np.full(shape, ticks(300.0)),
        **{
            name: np.zeros(shape, dtype=bool)
            for name in ("entered", "exited", "exited_correctly", "excursion")
        },
    }
    for slot, (flight, first, positions, levels) in enumerate(paths):
        rows = slice(first, first + len(positions) - 1)
        values["flight"][rows, slot] = flight
        values["before_nm"][rows, slot] = positions[:-1]
        values["position_nm"][rows, slot] = positions[1:]
        values["before_level_ticks"][rows, slot] = levels[:-1]
        values["level_ticks"][rows, slot] = levels[1:]
        values["entered"][rows, slot] = True
    for name, marks in events.items():
        for cycle, slot, value in marks:
            values[name][cycle, slot] = value
    for name in ("before_nm", "position_nm", "before_level_ticks", "level_ticks"):
        values[name] = values[name].astype(np.float32)
    traffic = Traffic(*[np.zeros(shape, dtype=np.float32)] * FIELDS)._replace(
        position_nm=values.pop("position_nm"),
        level_ticks=values.pop("level_ticks"),
        ground_speed_kt=np.full(shape, 600.0, dtype=np.float32),
        route=np.zeros(shape, dtype=np.int32),
    )
    return Hour(
        traffic=traffic,
        number=0,
        waiting=np.zeros(CYCLES, dtype=int),
        fail_safe=np.arange(CYCLES) % 2 == 0,
        sent=list(sent),
        decision_ms=np.arange(CYCLES, dtype=float),
        **values,
    )


def straight(first_nm, step_nm, rows, level=300.0):
    at = np.array(first_nm) + np.arange(rows + 1)[:, None] * np.array(step_nm)
    return at, np.full(rows + 1, ticks(level))


def head_on(first=0, north_nm=0.0, levels=(300.0, 300.0)):
    """Two flights that meet 10 cycles after the second one is born."""
    one = straight((-10.0 - first, 0.0), (1.0, 0.0), CYCLES, levels[0])
    other = straight((10.0, north_nm), (-1.0, 0.0), CYCLES - first, levels[1])
    return [(0, 0, *one), (1, first, *other)]


def test_a_loss_of_separation_is_counted_once_per_pair():
    scores = score(SECTOR, hour(head_on()))
    (loss,) = scores.losses
    # 20 NM apart, closing 2 NM a cycle: below 5 NM during the eighth.
    assert (loss.cycle, loss.first, loss.second) == (7, 0, 1)
    assert not loss.at_birth
    assert scores.lax_s == scores.lax_without_births_s == 6 * 8
    assert scores.lax_ended_by == scores.strict_ended_by == "loss"
    assert [each.cycle for each in scores.close_pairs] == [6]


@pytest.mark.parametrize(
    ("north_nm", "levels", "losses", "close_pairs"),
    [
        (4.9, (300.0, 300.0), 1, 1),
        (5.1, (300.0, 300.0), 0, 1),
        (7.1, (300.0, 300.0), 0, 0),
        (0.0, (300.0, 310.0), 0, 0),
        (0.0, (300.0, 309.0), 1, 1),
    ],
)
def test_separation_is_lost_below_both_standards(north_nm, levels, losses, close_pairs):
    scores = score(SECTOR, hour(head_on(0, north_nm, levels)))
    assert (len(scores.losses), len(scores.close_pairs)) == (losses, close_pairs)


def test_losses_at_birth_are_told_apart():
    one = straight((0.0, 0.0), (1.0, 0.0), CYCLES)
    other = straight((10.0, 3.0), (1.0, 0.0), CYCLES - 10)  # born 3 NM beside it
    scores = score(SECTOR, hour([(0, 0, *one), (1, 10, *other)]))
    assert [each.at_birth for each in scores.losses] == [True]
    assert (scores.lax_s, scores.lax_without_births_s) == (6 * 11, 6 * CYCLES)
    assert scores.lax_ended_by == "loss at birth"


def test_losses_outside_count_for_the_lax_score_once_both_are_inside():
    flown = hour(head_on(), entered=[(cycle, 1, False) for cycle in range(12)])
    scores = score(SECTOR, flown)
    assert scores.losses[0].cycle == 7
    # They are still within 5 NM in the cycles until 12.5 cycles after the start.
    assert scores.lax_s == 6 * 13


def test_excursions_and_wrong_levels_end_the_scores():
    path = (0, 0, *straight((0.0, 0.0), (1.0, 0.0), 20))
    scores = score(SECTOR, hour([path], excursion=[(19, 0, True)]))
    assert scores.lax_s == scores.strict_s == 6 * 20
    assert scores.lax_ended_by == scores.strict_ended_by == "excursion"
    scores = score(SECTOR, hour([path], exited=[(19, 0, True)]))
    assert (scores.lax_s, scores.strict_s) == (6 * CYCLES, 6 * 20)
    assert (scores.lax_ended_by, scores.strict_ended_by) == (None, "wrong exit level")
    scores = score(SECTOR, hour([path]))
    assert (scores.lax_s, scores.strict_s) == (6 * CYCLES, 6 * CYCLES)


def test_a_flight_that_exits_is_measured():
    """Along its route to the exit fix, 3 NM beside it, with one level-off on the way."""
    table = SECTOR.route_table
    exit_nm = table.fixes_nm[0, table.last_fix[0] - 1].astype(float)
    along = table.leg_direction[0, table.last_fix[0] - 1].astype(float)
    beside = 3.0 * np.array([along[1], -along[0]])
    at = np.array([exit_nm + beside + along * (step - 9.5) for step in range(21)])
    levels = np.full(21, ticks(300.0))
    levels[:5] = ticks(290.0) + np.array([0, 1, 2, 3, 3]) * 1000.0  # stops once below FL300
    levels[5:8] = levels[4] + np.array([0, 1, 2]) * 1000.0
    flown = hour(
        [(0, 0, at, levels)],
        sent=[Sent(3, 0, Transmission(0, heading_deg=90)), Sent(9, 0, Transmission(0, fix=1))],
        exited=[(19, 0, True)],
        exited_correctly=[(19, 0, True)],
    )
    (row,) = score(SECTOR, flown).flights
    assert (row.flight, row.birth, row.gone) == (0, 0, 19)
    assert row.exited
    assert row.correct
    assert row.flown_nm == pytest.approx(20.0, abs=0.02)
    assert row.transmissions == 2
    assert row.level_offs == 1


def test_the_summary_of_two_hours():
    one = hour(head_on(), sent=[Sent(number, 0, Transmission(0, fix=1)) for number in range(15)])
    path = (0, 0, *straight((0.0, 30.0), (1.0, 0.0), 20))
    other = hour([path], exited=[(19, 0, True)], exited_correctly=[(19, 0, True)])
    row = summary([score(SECTOR, each) for each in (one, other)], "mine", "60")
    assert (row["agent"], row["traffic"]) == ("mine", "60")
    assert row["hours"] == pytest.approx(2 * CYCLES * 6 / 3600)
    assert (row["flights"], row["flights_gone"]) == (3, 1)
    assert (row["losses_of_separation"], row["losses_at_birth"]) == (1, 0)
    assert (row["correct_exit_rate"], row["excursion_rate"]) == (1.0, 0.0)
    assert row["transmissions_per_flight"] == 5.0
    assert row["transmissions_worst_minute"] == 10
    assert row["transmissions_per_minute"] == pytest.approx(15 / 6)
    assert row["lax_s_by_hour"] == [48.0, 180.0]
    assert row["lax_s_mean"] == 114.0
    assert row["lax_ended_by"] == {"loss": 1}
    assert row["fail_safe_rate"] == 0.5
    assert row["decision_ms_median"] == 14.5
