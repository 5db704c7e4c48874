"""Messages of pages are read strictly: whatever arrives is a message or one line of refusal."""

import json
import random

import pytest

from skystack.errors import InputError
from skystack.live.messages import MOST_BYTES, AnswerAdvice, Clear, Follow, HandOver, read_message

VALID = [
    {"do": "play", "on": True},
    {"do": "speed", "times": 60},
    {"do": "step"},
    {"do": "clear", "text": "AC1 climb 340", "id": 7},
    {"do": "clear", "text": "AC1 climb 340", "modifies": [0, 2]},
    {"do": "trial", "text": "AC1 left heading 240"},
    {"do": "choices", "callsign": "AC1"},
    {"do": "advise", "conforms": True},
    {"do": "answer", "number": 3, "rank": 1, "answer": "accept"},
    {"do": "hand_over", "callsigns": ["AC1"], "to_adviser": True},
    {"do": "rewind", "cycle": 12},
    {"do": "follow", "epoch": -1, "updates": 0},
]


def test_reads_every_kind_of_message():
    kinds = {type(read_message(json.dumps(each))) for each in VALID}
    assert len(kinds) == len(VALID) - 1
    assert {Clear, HandOver, Follow, AnswerAdvice} <= kinds
    assert read_message(json.dumps(VALID[4])).modifies == (0, 2)


@pytest.mark.parametrize(
    "change",
    [
        {"do": "fly"},
        {"times": 3},
        {"text": "x" * 201},
        {"text": 5},
        {"rank": 10},
        {"cycle": -1},
        {"id": -1},
        {"more": 1},
        {"callsigns": ["AC1"] * 21},
        {"answer": "perhaps"},
    ],
)
def test_refuses_unknown_values(change):
    (name,) = change
    for valid in VALID if name in ("do", "id", "more") else (e for e in VALID if name in e):
        with pytest.raises(InputError, match="not understood"):
            read_message(json.dumps(valid | change))


def test_refuses_a_long_message():
    with pytest.raises(InputError, match=rf"{MOST_BYTES + 1} bytes \(allowed: {MOST_BYTES}\)"):
        read_message(b" " * (MOST_BYTES + 1))


def test_ten_thousand_mutated_messages_raise_nothing_else():
    """Bytes of valid messages are changed, deleted, doubled and nested at random."""
    draw = random.Random(0)
    reasons = []
    for _ in range(10_000):
        data = bytearray(json.dumps(draw.choice(VALID)).encode())
        for _ in range(draw.randrange(1, 6)):
            at = draw.randrange(len(data))
            match draw.randrange(4):
                case 0:
                    data[at] = draw.randrange(256)
                case 1:
                    del data[at : at + draw.randrange(1, 4)]
                    data = data or bytearray(b"{")
                case 2:
                    data[at:at] = data[at : at + draw.randrange(1, 20)]
                case _:
                    data[at:at] = draw.choice([b"[" * 500, b'{"a":' * 100, b"\xc3\x28", b"1e999"])
        try:
            read_message(bytes(data))
        except InputError as error:
            reasons.append(str(error))
    assert 5_000 < len(reasons) < 10_000
    assert not any("\n" in each for each in reasons)
