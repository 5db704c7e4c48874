"""A session controlled by a person, by an adviser, and by both; restored from its journal."""

from contextlib import contextmanager

import numpy as np
import pyarrow.parquet as pq
import pytest

from skystack.agents.transmission import Transmission
from skystack.errors import InputError
from skystack.evaluation.hour_row import read_row
from skystack.evaluation.stored import read_table
from skystack.live.advice import Adviser, most_urgent
from skystack.live.control import VALID_CYCLES, YOU, LiveControl
from skystack.live.journal import ClearanceIssued, CycleFlown, WentBack, open_journal
from skystack.live.server import LiveServer
from skystack.live.serving import header_of
from skystack.reporting.replay.recording import read_replay
from skystack.reporting.replay.side_by_side import read_side_by_side
from skystack.simulator.performance import TICKS_PER_FL
from skystack.simulator.traffic import ticks

from .made import ADVISER, on_frequency, opened


def begin(cycles=200, steps=0):
    control = LiveControl(opened(seed=3, cycles=cycles), cycles, ADVISER)
    for _ in range(steps):
        control.step()
    return control


@contextmanager
def journaled(folder, steps, out=None):
    """A session with a journal in a folder, after some cycles."""
    session = opened(seed=3)
    with open_journal(folder, header_of(session)) as (journal, _):
        control = LiveControl(session, 200, ADVISER, journal, out)
        for _ in range(steps):
            control.step()
        yield control


@pytest.fixture(scope="module")
def control():
    return begin(steps=60)


def clearances(control):
    return [each for each in control.history.updates if "clearances" in each]


def words(control):
    return [each["clearances"][0]["text"] for each in clearances(control)]


@pytest.mark.slow
def test_nobody_is_cleared_unless_somebody_does_it():
    assert clearances(begin(steps=30)) == []


@pytest.mark.slow
def test_a_trial_issues_nothing_and_says_what_the_clearance_does(control):
    name = on_frequency(control.hour)[0]
    slot, sent = control.hour.slots[name], len(control.history.updates)
    level = float(control.hour.state.traffic.level_ticks[slot]) / TICKS_PER_FL
    wanted = 200 if level > 300 else 400
    trial = control.trial(f"{name} {'descend' if wanted < level else 'climb'} {wanted}")
    assert len(control.history.updates) == sent
    assert trial["words"] == f"{name} {'descend' if wanted < level else 'climb'} FL{wanted}"
    start = control.hour.state.traffic.position_nm[slot]
    np.testing.assert_allclose(trial["path"][0], start, atol=1e-3)
    assert len(trial["path"]) > 3
    (of_level,) = [each for each in control.choices(name)["levels"] if each["fl"] == wanted]
    assert (of_level["least_nm"], of_level["lost_in_s"]) == (trial["least_nm"], trial["lost_in_s"])
    with pytest.raises(InputError, match="unknown callsign 'AC999'"):
        control.choices("AC999")


def test_a_clearance_is_read_back_and_in_the_history(control):
    name = on_frequency(control.hour)[0]
    assert control.clear(f"{name.lower()} left 20 degrees").endswith(f", {name}")
    assert clearances(control)[-1]["by"] == YOU
    with pytest.raises(InputError, match="was not understood"):
        control.clear(f"{name} do something")


def test_the_adviser_instructs_the_flights_that_were_handed_over():
    control = begin(steps=40)
    one, other = on_frequency(control.hour)[:2]
    control.hand_over([one], to_adviser=True)
    assert control.status()["handed"] == [one]
    control.step()
    assert [each.split()[0] for each in words(control)] == [one]
    assert clearances(control)[0]["by"] == ADVISER
    control.hand_over([], to_adviser=True)
    for _ in range(3):
        control.step()
    assert other in {each.split()[0] for each in words(control)}
    control.hand_over([other], to_adviser=False)  # all the others stay with the adviser
    assert control.status()["hands_all"] is False
    assert other not in control.status()["handed"]
    assert one in control.status()["handed"]
    control.hand_over([], to_adviser=False)
    count = len(clearances(control))
    for _ in range(20):
        control.step()
    assert len(clearances(control)) == count
    with pytest.raises(InputError, match="unknown callsign 'NOBODY'"):
        control.hand_over(["NOBODY"], to_adviser=True)


def test_there_is_nobody_to_hand_over_to_without_an_adviser():
    session = opened()._replace(adviser=None)
    control = LiveControl(session, 10)
    with pytest.raises(InputError, match=r"no adviser \(allowed: .*--adviser"):
        control.hand_over([], to_adviser=True)


def test_advice_is_accepted_refused_modified_and_logged(tmp_path):
    control = begin(steps=60)
    advice = control.advise()
    assert advice is not None
    assert 2 <= len(advice.alternatives) <= 3
    shown = control.shown
    assert shown["callsigns"] == [control.hour.callsigns[slot] for slot in advice.concern.slots]
    control.refuse(advice.number, 1)
    chosen = shown["alternatives"][0]["words"]
    read_back = control.accept(advice.number, 0)
    assert read_back == f"{chosen.removeprefix(chosen.split()[0])[1:]}, {chosen.split()[0]}"
    assert words(control)[-1] == chosen
    with pytest.raises(InputError, match="no such advice"):
        control.clear(f"{on_frequency(control.hour)[0]} fly heading 360", modifies=(7, 0))
    with pytest.raises(InputError, match=r"out of date \(allowed: ask again\)"):
        control.accept(advice.number, 0)
    control.step()
    later = control.advise()
    name = control.hour.callsigns[later.concern.slots[0]]
    control.clear(f"{name} fly heading 360", modifies=(later.number, 1))
    control.log.write(tmp_path)
    rows = pq.read_table(tmp_path / "advice.parquet").to_pylist()
    answers = [(each["advice"], each["rank"], each["answer"], each["issued"]) for each in rows]
    assert (0, 0, "accepted", None) in answers
    assert (0, 1, "refused", None) in answers
    assert (1, 1, "modified", words(control)[-1]) in answers
    assert (1, 0, None, None) in answers
    assert rows[0]["text"] == chosen
    assert control.log.chosen() == [rows[0]["kind"]]


@pytest.mark.parametrize("order", [1, -1])
def test_of_two_proposals_the_one_that_separates_is_shown(control, order):
    """The adviser clears both flights of a pair, and only one of its clearances helps."""
    state, what_if = control.hour.state, control._what_if
    slots = most_urgent(what_if, state).slots
    helps = next(
        Transmission(slot, level_ticks=ticks(float(each["fl"])))
        for slot in slots
        for each in control.choices(control.hour.callsigns[slot])["levels"]
        if each["lost_in_s"] is None
    )
    (other,) = set(slots) - {helps.slot}
    heading = round(float(state.traffic.heading_deg[other])) % 360
    proposed = [Transmission(other, heading_deg=heading), helps]

    class Both:
        def begin(self, state):
            pass

        def transmit(self, state):
            return proposed[::order]

    adviser = Adviser(control.hour.world, what_if, Both(), "both")
    best = adviser.advise(state, 0).alternatives[0]
    assert (best.source, best.transmission) == ("both", helps)


def test_advice_is_valid_for_some_cycles_as_long_as_its_flight_is_there():
    control = begin(steps=60)
    advice = control.advise()
    for _ in range(VALID_CYCLES):
        control.step()
    assert control.accept(advice.number, 0)
    advice = control.advise()
    for _ in range(VALID_CYCLES + 1):
        control.step()
    with pytest.raises(InputError, match=r"out of date \(allowed: ask again\)"):
        control.accept(advice.number, 0)
    advice = control.advise()
    name = control.shown["alternatives"][0]["callsign"]
    slot = control.hour.slots.pop(name)  # the flight has left, and another uses its slot
    control.hour.slots["ANOTHER"] = slot
    with pytest.raises(InputError, match="out of date"):
        control.accept(advice.number, 0)


def test_advice_is_shown_as_it_was_given_after_its_flights_have_left():
    control = begin(cycles=600, steps=60)
    advice = control.advise()
    shown = control.shown
    while control.hour.slots.keys() & set(shown["callsigns"]):
        control.step()
    news = LiveServer(control, "", "token", lambda line: None).news(-1, 0)
    assert news["advice"] == shown
    with pytest.raises(InputError, match="out of date"):
        control.accept(advice.number, 0)


def test_going_back_keeps_the_history_that_is_left(tmp_path):
    with journaled(tmp_path / "session", 50, tmp_path) as control:
        control.clear(f"{on_frequency(control.hour)[0]} left 20 degrees")
        control.step()
        epoch = control.history.epoch
        control.rewind(40)
        assert control.cycle == 40
        assert control.history.epoch != epoch
        assert clearances(control) == []
        control.step()
    (branch,) = control.branches
    (scenario,) = read_replay(branch).scenarios
    assert scenario.cycles == 51
    assert len(scenario.clearances) == 1
    folder, _ = control.opened.write(tmp_path)
    both = read_side_by_side([folder, branch])  # of different lengths
    assert [each.scenarios[0].cycles for each in both] == [41, 51]


def test_a_pending_clearance_is_not_recorded_and_does_not_prevent_going_back(tmp_path):
    with journaled(tmp_path / "session", 50, tmp_path) as control:
        name = on_frequency(control.hour)[0]
        control.clear(f"{name} left 20 degrees")
        control.step()
        control.clear(f"{name} left 30 degrees")
        folder, row = control.opened.write(tmp_path)
        control.rewind(40)
    assert row["agent"] == "session"
    assert read_table(folder / "clearances.parquet", ("cycle",)).to_pylist() == [{"cycle": 50}]
    (branch,) = control.branches
    assert branch.name.endswith("-branch-1")
    assert read_table(branch / "clearances.parquet", ("cycle",)).to_pylist() == [{"cycle": 50}]
    assert read_row(branch).agent == "session-branch-1"


def test_a_session_is_restored_from_its_journal(tmp_path):
    with journaled(tmp_path, 40) as control:
        control.hand_over([], to_adviser=True)
        control.step()
        control.rewind(39)
        control.hand_over([], to_adviser=False)
        control.clear(f"{on_frequency(control.hour)[1]} right 20 degrees, climb 400")
        control.advise()
        control.step()
    again = opened(seed=3)
    with open_journal(tmp_path, header_of(again)) as (journal, entries):
        restored = LiveControl(again, 200, ADVISER, journal)
        restored.restore(entries)
    assert restored.history.updates == control.history.updates
    assert restored.log.rows() == control.log.rows()
    for one, other in zip(again.hour.state.traffic, control.hour.state.traffic, strict=True):
        np.testing.assert_array_equal(one, other)
    folder, row = again.write(tmp_path / "out")
    assert row["transmissions_per_flight"] > 0.0
    assert read_table(folder / "clearances.parquet", ("callsign",)).num_rows == 2


def test_the_adviser_keeps_the_flights_handed_over_when_a_session_is_restored(tmp_path):
    with journaled(tmp_path, 40) as control:
        one, other = on_frequency(control.hour)[:2]
        control.hand_over([one, other], to_adviser=True)
        control.hand_over([other], to_adviser=False)
        control.step()
    again = opened(seed=3)
    with open_journal(tmp_path, header_of(again)) as (journal, entries):
        restored = LiveControl(again, 200, ADVISER, journal)
        restored.restore(entries)
    assert restored.status()["handed"] == [one]
    alone = LiveControl(opened(seed=3)._replace(adviser=None), 200)
    alone.restore(entries)  # without an adviser, no flight is handed over
    assert not alone.handed


def test_a_journal_of_other_traffic_is_refused(tmp_path):
    with journaled(tmp_path, 40) as control:
        control.clear(f"{on_frequency(control.hour)[-1]} left 20 degrees")
    other = opened(seed=4)
    with open_journal(tmp_path, header_of(control.opened)) as (_, entries):
        fewer = [each for each in entries if not isinstance(each, CycleFlown) or each.number < 5]
    with pytest.raises(InputError, match=r"the journal has .*--new"):
        LiveControl(other, 200, ADVISER).restore(fewer)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (CycleFlown(7), r"cycle 7 after cycle 40 \(allowed: 41; --new"),
        (CycleFlown(40), r"cycle 40 after cycle 40 \(allowed: 41; --new"),
        (ClearanceIssued("AC1", "you", level_ticks=9e8), r"the journal has FL.* for AC1 \(allowed"),
        (WentBack(5000), r"cycle 5000 \(allowed: 0 to 40"),
    ],
)
def test_a_journal_with_an_impossible_entry_is_refused(tmp_path, entry, message):
    with journaled(tmp_path, 40) as control:
        pass
    with open_journal(tmp_path, header_of(control.opened)) as (_, entries):
        pass
    with pytest.raises(InputError, match=message):
        LiveControl(opened(seed=3), 200, ADVISER).restore([*entries, entry])


def test_a_session_ends_after_its_cycles():
    control = begin(cycles=3)
    control.playing = True
    for _ in range(3):
        control.step()
    assert control.ended
    assert not control.playing
    with pytest.raises(InputError, match=r"ended after 3 cycles \(allowed: a larger --cycles\)"):
        control.step()
