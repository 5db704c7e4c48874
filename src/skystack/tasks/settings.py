"""The settings of a task: the `[task]` tables of an experiment's TOML. Data only."""

from typing import Annotated, Literal

import msgspec

from skystack.airspace.sector_file import SectorEntry
from skystack.simulator.fleet import AircraftType

PAPER_FEATURES = ("theta_f", "theta_sf", "d_c", "delta_t")

MOST_CYCLES = 10_000
"""As of a scenario file: more than 16 hours."""

Weight = Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)]


class RewardSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Weights of the reward's terms: the paper's table of weightings, and ours."""

    centreline: Weight = 1.0
    damping: Weight = 0.25
    terminal: Weight = 1.0
    count_criterion: bool = True
    """Whether fewer than 30 instructions per aircraft is one of the criteria."""
    safety: Weight = 0.0
    """Of the predicted closest approach of the worst pair."""
    vertical: Weight = 0.0
    burst: Weight = 0.0
    """Ours: the price of every burst, which stacking makes one clearance."""
    outside_band: Weight = 0.0
    """Ours: the cost per NM further from the centreline than the band."""
    band_nm: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 0.0
    stray: Weight = 0.0
    """Ours: the price of an excursion, paid when it happens."""
    conflict: Weight = 0.0
    """Ours: the cost of every cycle in which two aircraft are closer than `conflict_nm`."""
    conflict_nm: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 5.5


class TaskSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which scenarios, what the policy sees and says, and what it is rewarded for."""

    name: Literal["lateral", "vertical", "avoidance"] = "lateral"
    """`avoidance` is `lateral` by another name: what it sees and pays for is in the settings."""
    sector: str | SectorEntry = "x-plus"
    """A name, or the sector itself; in an experiment's file also the name of a sector file."""
    levels_fl: tuple[int, int] | None = None
    """The sector's lowest and highest level; its own where none is given."""
    performance: str = "table"
    aircraft: Annotated[int, msgspec.Meta(ge=1, le=200)] = 2
    level_fl: int | Annotated[tuple[int, ...], msgspec.Meta(min_length=1, max_length=61)] = 300
    """At which aircraft enter and leave; of several, each gets one (but not in `vertical`)."""
    fleet: Annotated[tuple[AircraftType, ...], msgspec.Meta(max_length=20)] = ()
    """Types of aircraft, one drawn for each; the B753 alone where none is given."""
    disc_nm: Annotated[float, msgspec.Meta(ge=0.0, le=50.0)] = 4.0
    """Radius of the disc round the first fix in which aircraft start."""
    cycles: Annotated[int, msgspec.Meta(ge=1, le=MOST_CYCLES)] = 300
    """The scenario ends after so many, if not before. The sector's shortest route must be flyable
    in them."""
    actions: Literal["small", "large", "levels"] = "small"
    """`small`: turns of 10 degrees; `large`: turns of 10 to 90 degrees; `levels`: 10 levels."""
    features: tuple[str, ...] = PAPER_FEATURES
    """What is shown of each aircraft; names in `skystack.tasks.features`."""
    pair_features: tuple[str, ...] = ()
    """What is shown of each pair of aircraft; names in `skystack.tasks.pairs`."""
    timing: Literal["cycle", "stack"] = "cycle"
    """What one training step is. `cycle`: an instruction and a radar cycle, as in the paper.
    `stack` (ours): an instruction takes no time, as it will be when stacked; only what would
    end the stack lets the traffic fly."""
    reward: RewardSettings = RewardSettings()
