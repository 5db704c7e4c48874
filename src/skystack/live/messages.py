"""The messages of pages to a session, as JSON objects with a field `do`.

They are untrusted: unknown fields, and values of a wrong type or out of range, are refused.
"""

from typing import Annotated, Literal

import msgspec

from skystack.errors import InputError
from skystack.live.clearance_text import MAX_CHARACTERS

MOST_BYTES = 2000
"""The maximum length of a message."""
_Id = Annotated[int, msgspec.Meta(ge=0, le=2**53)]
_Text = Annotated[str, msgspec.Meta(max_length=MAX_CHARACTERS)]
_Cycle = Annotated[int, msgspec.Meta(ge=0, le=100_000)]
_Rank = Annotated[int, msgspec.Meta(ge=0, le=9)]
_Callsign = Annotated[str, msgspec.Meta(max_length=100)]


class _Message(msgspec.Struct, tag_field="do", forbid_unknown_fields=True, kw_only=True):
    id: _Id = 0
    """Repeated in the reply."""


class Play(_Message, tag="play"):
    """Run the simulation, or pause it."""

    on: bool


class Speed(_Message, tag="speed"):
    """Set the speed, as a multiple of real time."""

    times: Literal[1, 2, 5, 10, 20, 30, 60]


class StepOnce(_Message, tag="step"):
    """Pause, and fly one cycle."""


class Clear(_Message, tag="clear"):
    """Issue a clearance.

    `modifies` are the number of the advice and the rank of the alternative that it changes.
    """

    text: _Text
    modifies: tuple[_Id, _Rank] | None = None


class TryClearance(_Message, tag="trial"):
    """Ask what a clearance would lead to."""

    text: _Text


class Choices(_Message, tag="choices"):
    """Ask for the fixes ahead of a flight, and what a clearance to each level would lead to."""

    callsign: _Callsign


class Advise(_Message, tag="advise"):
    """Ask for advice; `conforms` ranks it by earlier choices."""

    conforms: bool = False


class AnswerAdvice(_Message, tag="answer"):
    """Accept or refuse an alternative of the last advice."""

    number: _Id
    rank: _Rank
    answer: Literal["accept", "refuse"]


class HandOver(_Message, tag="hand_over"):
    """Hand flights over to the adviser, or take them back; an empty list means all."""

    callsigns: Annotated[list[_Callsign], msgspec.Meta(max_length=20)]
    to_adviser: bool


class Rewind(_Message, tag="rewind"):
    """Go back to the end of a cycle."""

    cycle: _Cycle


class Follow(_Message, tag="follow"):
    """What the page already has: the number of updates of an epoch."""

    epoch: Annotated[int, msgspec.Meta(ge=-1, le=2**53)]
    updates: Annotated[int, msgspec.Meta(ge=0, le=10_000_000)]


_Control = Play | Speed | StepOnce | HandOver | Rewind
Message = _Control | Clear | TryClearance | Choices | Advise | AnswerAdvice | Follow


def read_message(text: str | bytes) -> Message:
    """A message of a page. Raises InputError if it is not one."""
    if len(text) > MOST_BYTES:
        raise InputError(f"a message of {len(text)} bytes (allowed: {MOST_BYTES})")
    try:
        message: Message = msgspec.json.decode(text, type=Message)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise InputError(f"a message that is not understood: {error}") from None
    return message
