"""The log of advice: every alternative that was shown, and how it was answered."""

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from skystack.io.files import atomic_files, writing
from skystack.simulator.simulator import CYCLE_S

FILE = "advice.parquet"
Reply = Literal["accepted", "modified", "refused"]
_SCHEMA = pa.schema(
    [
        ("advice", pa.int32()),
        ("cycle", pa.int32()),
        ("time_s", pa.int32()),
        ("concern", pa.string()),
        ("flights", pa.string()),
        ("rank", pa.int32()),
        ("source", pa.string()),
        ("kind", pa.string()),
        ("text", pa.string()),
        ("least_nm", pa.float32()),
        ("extra_nm", pa.float32()),
        ("answer", pa.string()),
        ("issued", pa.string()),
    ]
)
_Text = Annotated[str, msgspec.Meta(max_length=500)]


class Shown(msgspec.Struct, forbid_unknown_fields=True):
    """An alternative that was shown, and how it was answered."""

    source: _Text
    kind: Literal["heading", "direct", "level"]
    text: _Text
    least_nm: float | None = None
    extra_nm: float | None = None
    answer: Reply | None = None
    """None if it was not answered."""
    issued: _Text | None = None
    """What was issued instead, if it was modified."""


class AdviceShown(msgspec.Struct, tag="advice", forbid_unknown_fields=True):
    """Advice that was shown: an entry of the journal."""

    number: Annotated[int, msgspec.Meta(ge=0)]
    cycle: Annotated[int, msgspec.Meta(ge=0)]
    concern: Literal["conflict", "exit"]
    flights: Annotated[list[_Text], msgspec.Meta(max_length=2)]
    alternatives: Annotated[list[Shown], msgspec.Meta(max_length=10)]


class AdviceAnswered(msgspec.Struct, tag="answer", forbid_unknown_fields=True):
    """The answer to an alternative: an entry of the journal."""

    number: Annotated[int, msgspec.Meta(ge=0)]
    """Of the advice."""
    rank: Annotated[int, msgspec.Meta(ge=0, le=9)]
    answer: Reply
    issued: _Text | None = None


class AdviceLog:
    """All advice of a session. What was shown stays in it when the session goes back in time."""

    def __init__(self) -> None:
        self._shown: dict[int, AdviceShown] = {}

    def __len__(self) -> int:
        return len(self._shown)

    def add(self, entry: AdviceShown | AdviceAnswered) -> None:
        """Add advice, or an answer to advice that was added; others are ignored."""
        if isinstance(entry, AdviceShown):
            self._shown[entry.number] = entry
        elif entry.number in self._shown:
            alternatives = self._shown[entry.number].alternatives
            if entry.rank < len(alternatives):
                alternatives[entry.rank].answer = entry.answer
                alternatives[entry.rank].issued = entry.issued

    def has(self, number: int, rank: int) -> bool:
        """Whether an alternative was shown."""
        return number in self._shown and rank < len(self._shown[number].alternatives)

    def chosen(self) -> list[str]:
        """The kinds of the alternatives that were accepted."""
        return [
            each.kind
            for shown in self._shown.values()
            for each in shown.alternatives
            if each.answer == "accepted"
        ]

    def rows(self) -> list[dict[str, Any]]:
        """One row per alternative."""
        return [
            {
                "advice": shown.number,
                "cycle": shown.cycle,
                "time_s": shown.cycle * CYCLE_S,
                "concern": shown.concern,
                "flights": " ".join(shown.flights),
                "rank": rank,
            }
            | msgspec.structs.asdict(each)
            for shown in self._shown.values()
            for rank, each in enumerate(shown.alternatives)
        ]

    def write(self, folder: Path) -> None:
        """Write the log as Parquet. Raises InputError if it cannot be written."""
        path = folder / FILE
        table = pa.Table.from_pylist(self.rows(), schema=_SCHEMA)
        with atomic_files([path]) as [file], writing(path):
            pq.write_table(table, file)
