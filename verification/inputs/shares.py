"""Which inputs a process tries, and what came of them. Imports nothing of skystack."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Tally:
    """What came of inputs so far."""

    read: int = 0
    refused: int = 0
    findings: dict[int, str] = field(default_factory=dict)
    """What was found, by the number of the input."""
    wall_s: float = 0.0

    @property
    def inputs(self) -> int:
        return self.read + self.refused + len(self.findings)

    def add(self, other: "Tally") -> None:
        self.read += other.read
        self.refused += other.refused
        self.findings |= other.findings
        self.wall_s += other.wall_s


@dataclass(frozen=True)
class Share:
    """The inputs that a process tries, from the first number to the one before the end."""

    format: str
    first: int
    end: int
    seed: int = 0
    seconds: float = 1e9
    guided: bool = False
    """Steered by the lines that inputs reach, in place of at random."""
    keep: Path | None = None
    """Where files of findings go, a folder each."""


def kept(share: Share, number: int, folder: Path) -> None:
    """Keep the files of an input that lie in a folder."""
    if share.keep is not None:
        name = f"{share.format}-{share.seed}-{number}{'-guided' if share.guided else ''}"
        shutil.copytree(folder, share.keep / name, dirs_exist_ok=True)
