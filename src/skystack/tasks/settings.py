"""The settings of tasks: the table `[task]` of an experiment's TOML."""

from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec

from skystack.airspace.sector_file import SectorEntry
from skystack.simulator.fleet import AircraftType
from skystack.simulator.limits import MAX_AIRCRAFT, MAX_CYCLES, MAX_TYPES
from skystack.tasks.rewards import MAX_WEIGHT, REWARDS, Parameter

PAPER_FEATURES = ("theta_f", "theta_sf", "d_c", "delta_t")


class TaskSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The settings common to all tasks. Each task adds its own."""

    name: str = "lateral"
    """The name of the task. `skystack list` prints all names."""
    sector: str | SectorEntry = "x-plus"
    """The name of a sector or the sector itself. In an experiment file also the name of a sector
    file."""
    cycles: Annotated[int, msgspec.Meta(ge=1, le=MAX_CYCLES)] = 300
    """The time limit of a scenario in cycles. It must suffice for the sector's shortest route."""
    timing: Literal["cycle", "stack"] = "cycle"
    """The meaning of one training step. `cycle`: an instruction and a radar cycle, as in the paper.
    `stack` (not in the paper): an instruction takes no simulated time, as with online
    action-stacking, and a cycle is flown only when the stack ends."""


def _field(name: str, parameter: Parameter) -> tuple[str, Any, Any]:
    if isinstance(parameter.default, bool):
        return name, bool, parameter.default
    allowed = msgspec.Meta(ge=parameter.low, le=parameter.high)
    return name, Annotated[float, allowed], parameter.default


def _fields() -> list[tuple[str, Any, Any]]:
    """A field for each weight and parameter in `REWARDS`."""
    fields = []
    for name, reward in REWARDS.items():
        fields.append(_field(name, Parameter(reward.default, reward.description, high=MAX_WEIGHT)))
        fields += [_field(key, parameter) for key, parameter in reward.parameters.items()]
    return fields


if TYPE_CHECKING:

    class RewardSettings(msgspec.Struct, frozen=True):
        """The weights and parameters of `skystack.tasks.rewards.REWARDS`."""

        def __init__(self, **weights: float | bool) -> None: ...

        def __getattr__(self, name: str) -> Any: ...

else:
    RewardSettings = msgspec.defstruct(
        "RewardSettings",
        _fields(),
        module=__name__,
        frozen=True,
        forbid_unknown_fields=True,
        namespace={
            "__doc__": "The weights and parameters of `skystack.tasks.rewards.REWARDS`: "
            "the paper's table of weightings and skystack's additions."
        },
    )


class NavigationSettings(TaskSettings, frozen=True, forbid_unknown_fields=True):
    """The scenarios, the observation, the actions and the rewards of the paper's tasks."""

    levels_fl: tuple[int, int] | None = None
    """The lowest and highest level of the sector. None means those in the sector's definition."""
    performance: str = "table"
    """The name of the performance model in `skystack.simulator.performance`."""
    aircraft: Annotated[int, msgspec.Meta(ge=1, le=MAX_AIRCRAFT)] = 2
    level_fl: int | Annotated[tuple[int, ...], msgspec.Meta(min_length=1, max_length=61)] = 300
    """The entry and exit level of all aircraft. If it is a list, each aircraft draws one. Not used
    by `vertical`."""
    fleet: Annotated[tuple[AircraftType, ...], msgspec.Meta(max_length=MAX_TYPES)] = ()
    """The types of aircraft; each aircraft draws one. If empty, all are B753."""
    disc_nm: Annotated[float, msgspec.Meta(ge=0.0, le=50.0)] = 4.0
    """Radius of the disc around the first fix in which aircraft start. Not used by `vertical`."""
    exit_nm: Annotated[float, msgspec.Meta(ge=0.1, le=50.0)] | None = None
    """Half the width of an exit: how far from the exit fix an aircraft may leave. None means the
    whole edge on which the exit fix lies."""
    exit_before_nm: Annotated[float, msgspec.Meta(ge=0.0, le=20.0)] = 0.0
    """How far inside the sector an exit lies, along the leg to the exit fix."""
    airway_nm: Annotated[float, msgspec.Meta(ge=0.1, le=50.0)] | None = None
    """The distance from the centreline beyond which an aircraft has made an excursion. None means
    that only leaving the sector is one."""
    control: Literal["always", "entered"] = "always"
    """Whether aircraft can be instructed from the start, or only after they have entered."""
    ends_early: bool = True
    """Whether a scenario ends when all aircraft have left; otherwise it lasts `cycles`."""
    actions: Literal["small", "large", "levels"] = "small"
    """`small`: turns of 10 degrees; `large`: turns of 10 to 90 degrees; `levels`: climbs and
    descents of 10 flight levels."""
    features: tuple[str, ...] = PAPER_FEATURES
    """The observed features of each aircraft; names in `skystack.tasks.features`."""
    pair_features: tuple[str, ...] = ()
    """The observed features of each pair of aircraft; names in `skystack.tasks.pairs`."""
    reward: RewardSettings = RewardSettings()
