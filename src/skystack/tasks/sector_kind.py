"""The settings of the task `sector-control`, and how it is built from them."""

from dataclasses import replace
from typing import Annotated

import msgspec

from skystack.airspace.sectors import sector_from
from skystack.errors import InputError
from skystack.simulator.arrival_flows import MAX_FLIGHTS_PER_HOUR, Flow, constant_rate
from skystack.simulator.limits import MAX_CYCLES
from skystack.simulator.performance import performance
from skystack.simulator.simulator import Simulator
from skystack.tasks.features import FEATURES
from skystack.tasks.kinds import Family, ObservedValue, RewardTerm, TaskDescription, TaskKind
from skystack.tasks.outlook import WAYS
from skystack.tasks.prediction import HORIZON_S
from skystack.tasks.sector_control import SectorControl
from skystack.tasks.sector_observation import NAVIGATION, OTHER, OWN, SEEN
from skystack.tasks.sector_rewards import SECTOR_REWARDS, SectorRewardSettings
from skystack.tasks.sector_stacks import SectorStacks
from skystack.tasks.settings import TaskSettings

MAX_SLOTS = 256

Rate = Annotated[float, msgspec.Meta(gt=0.0, le=MAX_FLIGHTS_PER_HOUR)]


class SectorSettings(TaskSettings, frozen=True, forbid_unknown_fields=True):
    """The traffic and the rewards of sector control."""

    name: str = SectorControl.name
    cycles: Annotated[int, msgspec.Meta(ge=1, le=MAX_CYCLES)] = 600
    """The maximum length of a training scenario in cycles. Lengths are random, at least a third of
    this."""
    performance: str = "constant"
    """The name of the performance model in `skystack.simulator.performance`."""
    slots: Annotated[int, msgspec.Meta(ge=2, le=MAX_SLOTS)] = 48
    """The maximum number of flights at once in training; further ones wait."""
    candidates: Annotated[int, msgspec.Meta(ge=16, le=4096)] = 256
    """The number of flights drawn for a scenario; they are used again if there are too few."""
    flights_per_hour: tuple[Rate, Rate] = (20.0, 150.0)
    """The lowest and highest rate of arrivals; each scenario draws one."""
    reward: SectorRewardSettings = SectorRewardSettings()  # type: ignore[valid-type]


def build_sector_control(settings: SectorSettings) -> SectorControl:
    """The task with the given settings. Raises InputError for contradictory settings."""
    low, high = settings.flights_per_hour
    if low > high:
        raise InputError(f"task.flights_per_hour is {low:g} to {high:g} (allowed: lowest first)")
    sector = sector_from(settings.sector)
    simulator = Simulator(sector, performance(settings.performance), own_navigation=True)
    flow = Flow(
        simulator,
        replace(constant_rate(high), attempts=4),
        slots=settings.slots,
        cycles=settings.cycles,
        candidates=settings.candidates,
        rate_factors=(low / high, 1.0),
    )
    return SectorControl(flow, settings.cycles, settings.reward)


def describe_sector_control(settings: SectorSettings) -> TaskDescription:
    """The description of the task with the given settings."""
    sector = settings.sector if isinstance(settings.sector, str) else settings.sector.name
    low, high = settings.flights_per_hour
    observed = [
        ObservedValue(name, each.description, each.low, each.high) for name, each in OWN.items()
    ]
    for name in NAVIGATION:
        feature = FEATURES[name]
        observed.append(ObservedValue(name, feature.meaning, feature.low, feature.high))
    observed += [
        ObservedValue(f"time to loss, {way}", "time until separation is lost, s", 0.0, HORIZON_S)
        for way in WAYS
    ]
    observed += [
        ObservedValue(f"other 1 to {SEEN} {name}", each.description, each.low, each.high)
        for name, each in OTHER.items()
    ]
    rewards = tuple(
        RewardTerm(name, each.description, weight, bool(weight))
        for name, each in SECTOR_REWARDS.items()
        for weight in [float(getattr(settings.reward, name))]
    )
    return TaskDescription(
        summary=(
            f"to control all flights through the sector {sector}, with {low:g} to {high:g} "
            "arrivals per hour, by headings, levels and clearances direct to fixes"
        ),
        observed=tuple(observed),
        rewards=rewards,
        criteria=("every flight leaves through its exit at its exit level",),
        observes_others=True,
    )


SECTOR_KIND = TaskKind(
    family=Family(SectorControl.name, "Sector control"),
    settings=SectorSettings,
    build=build_sector_control,
    description="many flights that arrive and leave, headings and levels together",
    stacked=SectorStacks,
    describe=describe_sector_control,
)
