"""A journal is continued where its session ended; lines that no session writes are refused."""

import msgspec
import pytest

from skystack.errors import InputError
from skystack.live.advice_log import AdviceAnswered
from skystack.live.journal import (
    FILE,
    FOLDER,
    ClearanceIssued,
    CycleFlown,
    Header,
    WentBack,
    open_journal,
)

HEADER = Header(
    traffic="60", seed=0, sector="a", start="b", performance="constant", platform="skystack"
)
ENTRIES = [
    CycleFlown(1),
    ClearanceIssued("AC1", "you", heading_deg=0, turn="left"),
    ClearanceIssued("AC2", "search", fix=3, level_ticks=120.0, instructions=4),
    CycleFlown(2),
    AdviceAnswered(0, 1, "modified", "AC1 fly heading 360"),
    WentBack(1),
]


@pytest.fixture
def written(tmp_path):
    with open_journal(tmp_path, HEADER) as (journal, entries):
        assert entries == []
        for each in ENTRIES:
            journal.add(each)
    return tmp_path


def path_of(session):
    return session / FOLDER / FILE


def test_entries_come_back_and_further_ones_are_appended(written):
    with open_journal(written, HEADER) as (journal, entries):
        assert entries == ENTRIES
        journal.add(CycleFlown(2))
    with open_journal(written, HEADER) as (_, entries):
        assert entries == [*ENTRIES, CycleFlown(2)]


def test_every_prefix_of_the_file_is_a_journal(written):
    """A process that is killed leaves a prefix; an entry that is not complete is dropped."""
    data = path_of(written).read_bytes()
    ends = [at + 1 for at, byte in enumerate(data) if byte == ord("\n")]
    for length in range(0, len(data), 7):
        path_of(written).write_bytes(data[:length])
        with open_journal(written, HEADER) as (journal, entries):
            assert entries == ENTRIES[: max(sum(end <= length for end in ends) - 1, 0)]
            journal.add(CycleFlown(9))
        with open_journal(written, HEADER) as (_, again):
            assert again == [*entries, CycleFlown(9)]


@pytest.mark.parametrize(
    "change",
    [{"seed": 1}, {"sector": "b"}, {"start": "c"}, {"platform": "bluesky"}, {"version": "0"}],
)
def test_a_journal_of_another_session_is_kept(written, change):
    data, other = path_of(written).read_bytes(), msgspec.structs.replace(HEADER, **change)
    with pytest.raises(InputError, match=r"session\.jsonl belongs to a session with .*--new"):
        open_journal(written, other).__enter__()
    assert path_of(written).read_bytes() == data
    with open_journal(written, other, fresh=True) as (_, entries):
        assert entries == []


def test_a_fresh_journal_is_empty(written):
    with open_journal(written, HEADER, fresh=True) as (_, entries):
        assert entries == []
    with open_journal(written, HEADER) as (_, entries):
        assert entries == []


def test_only_one_session_uses_a_journal(written):
    inner = open_journal(written, HEADER)
    with open_journal(written, HEADER), pytest.raises(InputError, match="in use"), inner:
        pass


@pytest.mark.parametrize(
    "line",
    [
        b"nonsense",
        b'{"type": "cycle"}',
        b'{"type": "cycle", "number": -1}',
        b'{"type": "clearance", "callsign": "AC1", "by": "you", "heading_deg": 360}',
        b'{"type": "clearance", "callsign": "AC1", "by": "you", "turn": "up"}',
        b'{"type": "cycle", "number": 1, "more": 1}',
        b'{"type": "order"}',
        b"[" * 100_000,
        b"\xff\xfe",
    ],
)
def test_refuses_a_damaged_journal_in_one_line_and_keeps_it(written, line):
    data = path_of(written).read_bytes() + line + b"\n"
    path_of(written).write_bytes(data)
    with pytest.raises(InputError, match=r"session\.jsonl, line 8: .*--new") as error:
        open_journal(written, HEADER).__enter__()
    assert "\n" not in str(error.value)
    assert path_of(written).read_bytes() == data
