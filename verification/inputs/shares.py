"""The inputs that a process tries, and their results. Imports nothing of skystack."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Tally:
    """The results of the inputs so far."""

    read: int = 0
    refused: int = 0
    findings: dict[int, str] = field(default_factory=dict)
    """Descriptions of the findings by the number of the input."""
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
    """The inputs that a process tries: numbers `first` to `end` - 1."""

    format: str
    first: int
    end: int
    seed: int = 0
    seconds: float = 1e9
    guided: bool = False
    """Whether a fuzzer chooses the inputs by the lines that they reach; otherwise random."""
    keep: Path | None = None
    """The folder for the files of findings, with a subfolder for each."""


def keep_files(share: Share, number: int, folder: Path) -> None:
    """Copy the files of an input from its folder to `share.keep`, if that is given."""
    if share.keep is not None:
        name = f"{share.format}-{share.seed}-{number}{'-guided' if share.guided else ''}"
        shutil.copytree(folder, share.keep / name, dirs_exist_ok=True)
