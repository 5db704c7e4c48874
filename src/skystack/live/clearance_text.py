"""Clearances as controllers type or say them: "BAW12 turn left heading 240, climb FL340".

Case, commas and filler words do not matter. Numbers may be digits or the words of ICAO phraseology
("two four zero", "flight level three hundred"). `parse_clearance` reads everything that
`skystack.platforms.phraseology` writes.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

from skystack.errors import InputError, unknown_name
from skystack.platforms.phraseology import DIGITS

MAX_CHARACTERS = 200
"""The maximum length of a clearance in characters."""
_VARIANTS = {"nine": "9", "tree": "3", "fower": "4", "fife": "5"}
_DIGIT_OF = {word: str(digit) for digit, word in enumerate(DIGITS)} | _VARIANTS
_FILLERS = {"and", "to", "then", "please", "the", "proceed"}
_ALLOWED = (
    "[turn] left, right or fly heading 001 to 360; left or right 10 degrees; climb, descend or "
    "maintain a flight level; direct and a fix; resume own navigation"
)


@dataclass(frozen=True)
class ParsedClearance:
    """What a clearance says. `turn` and `vertical` are None if they are not given."""

    callsign: str
    heading_deg: int | None = None
    """Whole degrees in [1, 360]."""
    turn: Literal["left", "right"] | None = None
    by_deg: int | None = None
    """Degrees to turn from the present heading."""
    level_fl: int | None = None
    vertical: Literal["climb", "descend"] | None = None
    direct_to: str | None = None
    """A fix."""
    own_navigation: bool = False
    """Whether to resume own navigation, direct to `direct_to` or to the next fix."""


def parse_clearance(text: str, callsigns: Collection[str]) -> ParsedClearance:
    """The clearance of a text, to one of the flights with these callsigns.

    Raises InputError for a text that is not understood, that is ambiguous, or that gives an element
    twice. Whether the flight can fly the clearance is not checked.
    """
    if len(text) > MAX_CHARACTERS:
        raise InputError(
            f"a clearance of {len(text)} characters (allowed: at most {MAX_CHARACTERS})"
        )
    words = _words(text)
    if not words:
        raise InputError("an empty text (allowed: a callsign and a clearance)")
    callsign = _flight(words, callsigns)
    return _Reader(callsign, _joined(words[len(_words(callsign)) :])).read()


def _words(text: str) -> list[str]:
    return re.sub(r"[,.;:]", " ", text).split()


def _flight(words: list[str], callsigns: Collection[str]) -> str:
    """The callsign that the words begin with: exactly, or else in any case if only one matches.

    A callsign may consist of several words. The longest that matches is meant.
    """
    folded = [word.casefold() for word in words]
    begun = [each for each in callsigns if _begins(folded, _words(each.casefold()))]
    most = max((len(_words(each)) for each in begun), default=0)
    longest = [each for each in begun if len(_words(each)) == most]
    exact = [each for each in longest if _begins(words, _words(each))]
    if len(exact or longest) != 1:
        raise unknown_name("callsign", words[0], callsigns)
    return (exact or longest)[0]


def _begins(words: list[str], first: list[str]) -> bool:
    return bool(first) and words[: len(first)] == first


def _joined(words: list[str]) -> list[str]:
    """The words in lower case, with spoken digits joined to numbers, and `fl340` split."""
    found: list[str] = []
    digits = ""
    for word in [*(each.casefold() for each in words), ""]:
        if word in _DIGIT_OF:
            digits += _DIGIT_OF[word]
        elif word == "hundred" and digits:
            digits += "00"
        else:
            found += [digits] * bool(digits)
            digits = ""
            level = re.fullmatch(r"fl(\d+)", word)
            found += ["fl", level[1]] if level else [word]
    return [word for word in found if word and word not in _FILLERS]


_DEGREES = ("degrees", "degree", "deg")


def _is_number(word: str) -> bool:
    return word.isascii() and word.isdigit()


class _Reader:
    """Reads the elements of a clearance, word by word."""

    def __init__(self, callsign: str, words: list[str]) -> None:
        self._callsign, self._words, self._at = callsign, words, 0
        self._found: dict[str, object] = {}

    def read(self) -> ParsedClearance:
        while self._at < len(self._words):
            self._element()
        if not self._found:
            raise InputError(f"no clearance for {self._callsign} (allowed: {_ALLOWED})")
        if {"heading_deg", "by_deg"} & self._found.keys() and "own_navigation" in self._found:
            raise InputError("a heading and own navigation (allowed: one of them)")
        return ParsedClearance(self._callsign, **self._found)  # type: ignore[arg-type]

    def _element(self) -> None:
        if self._takes("turn", "fly") and not self._next("left", "right", "heading"):
            raise self._not_understood()
        if self._next("left", "right"):
            self._turn()
        elif self._takes("heading"):
            self._set(heading_deg=self._heading())
        elif self._next("climb", "descend"):
            vertical = self._take()
            self._takes("maintain")
            self._set(level_fl=self._level(), vertical=vertical)
        elif self._takes("maintain") or self._next("fl", "flight", "level"):
            self._set(level_fl=self._level())
        elif self._next("resume", "direct"):
            self._navigation()
        else:
            raise self._not_understood()

    def _level(self) -> int:
        self._takes("fl", "flight")
        self._takes("level")
        return self._number("flight level")

    def _navigation(self) -> None:
        if self._takes("direct"):
            if self._at == len(self._words):
                raise InputError("direct without a fix (allowed: direct and a fix of the route)")
            self._found.setdefault("own_navigation", True)
            self._set(direct_to=self._take().upper())
            return
        self._take()
        if not (self._takes("own") and self._takes("navigation")):
            raise self._not_understood()
        self._set(own_navigation=True)

    def _turn(self) -> None:
        turn = self._take()
        if self._takes("heading"):
            self._set(turn=turn, heading_deg=self._heading())
            return
        if self._words[self._at + 1 : self._at + 2] and self._words[self._at + 1] in _DEGREES:
            number = self._number("degrees")
            self._at += 1
            if not 1 <= number <= 180:
                raise InputError(f"a turn of {number} degrees (allowed: 1 to 180)")
            self._set(turn=turn, by_deg=number)
        else:
            self._set(turn=turn, heading_deg=self._heading())

    def _heading(self) -> int:
        """A heading of three digits, so that `left 20` is not taken for heading 020."""
        word = self._words[self._at] if self._at < len(self._words) else ""
        if not (len(word) == 3 and _is_number(word) and int(word) <= 360):
            raise InputError(f"heading {word!r} (allowed: three digits, 001 to 360)")
        self._at += 1
        return int(word) or 360

    def _number(self, what: str) -> int:
        word = self._words[self._at] if self._at < len(self._words) else ""
        if not (_is_number(word) and len(word) <= 3):
            raise InputError(f"{what} {word!r} (allowed: up to three digits)")
        self._at += 1
        return int(word)

    def _set(self, **values: object) -> None:
        for name in values:
            if name in self._found and name != "own_navigation":
                raise InputError(f"more than one {_NAMES[name]} (allowed: one)")
        if {"heading_deg", "by_deg"} <= self._found.keys() | values.keys():
            raise InputError("more than one heading (allowed: one)")
        self._found |= values

    def _next(self, *words: str) -> bool:
        return self._at < len(self._words) and self._words[self._at] in words

    def _takes(self, *words: str) -> bool:
        found = self._next(*words)
        self._at += found
        return found

    def _take(self) -> str:
        self._at += 1
        return self._words[self._at - 1]

    def _not_understood(self) -> InputError:
        word = self._words[self._at] if self._at < len(self._words) else self._words[-1]
        return InputError(f"{word!r} was not understood (allowed: {_ALLOWED})")


_NAMES = {
    "heading_deg": "heading",
    "by_deg": "heading",
    "turn": "heading",
    "level_fl": "level",
    "vertical": "level",
    "direct_to": "fix",
    "own_navigation": "own navigation",
}
