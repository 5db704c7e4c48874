"""Traffic under clearances that are issued by text, and what is recorded of it."""

import numpy as np
import pytest

from skystack.errors import InputError
from skystack.evaluation.hour_scores import score
from skystack.evaluation.hours import OwnHours
from skystack.live.hour import LiveHour
from skystack.platforms.phraseology import written
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import ticks

from .made import WORLD, begun_hour, on_frequency


@pytest.fixture(scope="module")
def begun():
    return begun_hour()


def test_a_clearance_takes_no_time_and_is_then_flown(begun):
    name = on_frequency(begun)[0]
    slot, cycle = begun.slots[name], begun.cycle
    traffic = begun.state.traffic
    heading = round(float(traffic.heading_deg[slot]))
    wanted = (heading + 270) % 360 or 360
    level = float(traffic.level_ticks[slot]) / TICKS_PER_FL
    wanted_fl = 200 if level > 300 else 400
    worded = begun.issue(f"{name} turn right heading {wanted:03d}, maintain FL{wanted_fl}")
    assert begun.cycle == cycle
    np.testing.assert_array_equal(begun.state.traffic.position_nm, traffic.position_nm)
    assert written(worded) == (
        f"{name} turn right heading {wanted:03d}, "
        f"{'climb' if wanted_fl > level else 'descend'} FL{wanted_fl}"
    )
    assert begun.state.traffic.cleared_level_ticks[slot] == ticks(float(wanted_fl))
    for _ in range(3):  # the direction is obeyed, although left is shorter
        begun.advance()
    turned = (float(begun.state.traffic.heading_deg[slot]) - heading) % 360.0
    assert turned == pytest.approx(2 * 6 * 1.5, abs=0.6)
    assert begun.recorded().sent[-1].cycle == cycle


def test_own_navigation_is_resumed_to_the_next_or_a_later_fix(begun):
    name = on_frequency(begun)[1]
    slot = begun.slots[name]
    route = WORLD.sector.routes[int(begun.state.traffic.route[slot])]
    following = int(begun.state.progress.next_fix[slot])
    worded = begun.issue(f"{name} resume own navigation")
    assert worded.direct_to == route[following]
    worded = begun.issue(f"{name} direct {route[-1].lower()}")
    assert worded.direct_to == route[-1]
    begun.advance()
    assert bool(begun.state.traffic.own_navigation[slot])
    assert int(begun.state.traffic.next_fix[slot]) == len(route) - 1


def test_turns_by_degrees_are_from_the_present_heading(begun):
    name = on_frequency(begun)[2]
    heading = round(float(begun.state.traffic.heading_deg[begun.slots[name]]))
    worded = begun.issue(f"{name} left 30 degrees")
    assert (worded.heading_deg, worded.turn) == ((heading - 30) % 360, "left")


@pytest.mark.parametrize(
    ("clearance", "message"),
    [
        ("climb 410", r"to FL410 \(allowed: FL200 to FL400, in steps of 10\)"),
        ("maintain 305", "in steps of 10"),
        ("direct nowhere", r"direct NOWHERE \(allowed: "),
        ("climb 200", r"climb FL200: it is at FL\d+"),
    ],
)
def test_refuses_what_cannot_be_flown_and_issues_nothing(begun, clearance, message):
    name = on_frequency(begun)[0]
    sent = len(begun._recorder.sent)
    with pytest.raises(InputError, match=message):
        begun.issue(f"{name} {clearance}")
    assert len(begun._recorder.sent) == sent


def test_the_recording_is_scored_like_any_hour(begun):
    scores = score(WORLD.sector, begun.recorded())
    assert len(scores.flights) >= 3


def test_going_back_restores_the_state_and_forgets_the_rest():
    hour = begun_hour(flights=2)
    cycle, state, slots = hour.cycle, hour.state, dict(hour.slots)
    name = on_frequency(hour)[0]
    hour.issue(f"{name} fly heading 090")
    for _ in range(30):
        hour.advance()
    flown, callsigns = hour.state, dict(hour.slots)
    hour.rewind(cycle)
    assert (hour.cycle, hour.slots) == (cycle, slots)
    np.testing.assert_array_equal(hour.state.traffic.position_nm, state.traffic.position_nm)
    assert hour.state.traffic.cleared_heading_deg[slots[name]] != 90.0
    hour.issue(f"{name} fly heading 090")  # the same again leads to the same
    for _ in range(30):
        hour.advance()
    assert hour.slots == callsigns
    np.testing.assert_array_equal(hour.state.traffic.position_nm, flown.traffic.position_nm)
    recorded = hour.recorded()
    assert len(recorded.flight) == hour.cycle
    assert [each.cycle for each in recorded.sent] == [cycle]
    with pytest.raises(InputError, match=rf"cycle 999 \(allowed: 0 to {hour.cycle},"):
        hour.rewind(999)


class OtherSimulator:
    """Another simulator, which can only begin again; it is ours with another name."""

    def __init__(self):
        self.hours, self.resets, self.closed = OwnHours(WORLD), 0, False

    def reset(self, seed, number):
        self.resets += 1
        self.state = self.hours.reset(seed, number)
        return self.state

    def advance(self, state, transmissions):
        self.state, cycle = self.hours.advance(self.state, transmissions)
        return self.state, cycle

    def close(self):
        self.closed = True


def test_going_back_flies_the_clearances_again_in_another_simulator():
    elsewhere = OtherSimulator()
    hour = LiveHour(WORLD, seed=3, hours=elsewhere)
    while sum(hour.state.hears) < 1:
        hour.advance()
    name, *_ = on_frequency(hour)
    hour.issue(f"{name} fly heading 090")
    hour.issue(f"{name} maintain FL200")  # a second clearance in the same cycle
    for _ in range(5):
        hour.advance()
    cycle, state = hour.cycle, hour.state
    hour.issue(f"{name} fly heading 270")
    for _ in range(5):
        hour.advance()
    hour.rewind(cycle)
    assert elsewhere.resets == 2
    np.testing.assert_array_equal(elsewhere.state.traffic.position_nm, state.traffic.position_nm)
    hour.advance()
    assert hour.state.traffic.cleared_heading_deg[hour.slots[name]] == 90.0
    assert hour.state.traffic.cleared_level_ticks[hour.slots[name]] == ticks(200.0)
    hour.close()
    assert elsewhere.closed
