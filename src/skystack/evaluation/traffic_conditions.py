"""The conditions of an evaluation on hours of arriving traffic."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from skystack.agents.transmission import PER_CYCLE
from skystack.errors import InputError, suggestion
from skystack.evaluation.fixed_traffic import SPRINGFIELD, is_fixed
from skystack.evaluation.scenario_traffic import (
    SCENARIO_SUFFIX,
    is_scenario,
    is_scenario_file,
    scenario_world,
)
from skystack.learning.experiment import experiment_names
from skystack.platforms.registry import OWN, check_platform
from skystack.simulator.arrival_flows import (
    FLIGHT_SCHOOL,
    HOUR_CYCLES,
    STARTERS,
    Flow,
    constant_rate,
)
from skystack.simulator.simulator import Simulator

SPEED_SPREAD, CLIMB_SPREAD = 0.03, 0.10
"""The spread of airspeeds and of rates of climb and descent with `uncertainty`."""
ALIASES = {"flight-school": "category"}
"""Other names for traffic."""
BLUEBIRD, BLUESKY = "bluebird", "bluesky"
"""The other platforms."""
_SLOTS = (16, 32, 64, 128, 256)


class TrafficConditions(NamedTuple):
    """The traffic of an evaluation, and what the controller is allowed."""

    traffic: str
    """Flights per hour, a name in `FLIGHT_SCHOOL`, `springfield:` and a scenario, the name or file
    of an experiment, or a scenario file."""
    hours: int = 1
    seed: int = 0
    per_cycle: int | None = None
    """The maximum number of transmissions in a cycle; None for the agent's default."""
    cycles: int = 600
    """The length of an hour in cycles; shorter values are for quick checks."""
    sector: str | None = None
    """A sector to use instead of the agent's."""
    uncertainty: bool = False
    """Whether speeds and rates of climb differ from the nominal ones at random."""
    safety_net: bool = True
    """Whether a policy flies with its safety net."""
    platform: str = OWN
    """The simulator: `skystack`, `bluebird` or `bluesky`."""

    @property
    def options(self) -> list[str]:
        """`--per-cycle`, `--uncertainty`, `--no-safety-net` and `--platform`, unless at default."""
        differs = {
            f"--per-cycle {self.per_cycle}": self.per_cycle not in (None, PER_CYCLE),
            "--uncertainty": self.uncertainty,
            "--no-safety-net": not self.safety_net,
            f"--platform {self.platform}": self.platform != OWN,
        }
        return [option for option, given in differs.items() if given]

    @property
    def options_in_names(self) -> list[str]:
        """The sector and the options as in folder names: `crossing`, `per-cycle-1`."""
        sector = [] if self.sector is None else [Path(self.sector).stem]
        return sector + [each.removeprefix("--").replace(" ", "-") for each in self.options]

    @property
    def is_the_same_for_every_seed(self) -> bool:
        return is_fixed(self.traffic) or is_scenario_file(self.traffic)

    @property
    def recorded_traffic(self) -> str:
        """The traffic as it is recorded: a file without its folder."""
        return Path(self.traffic).name if is_scenario(self.traffic) else self.traffic

    @property
    def traffic_in_names(self) -> str:
        """The traffic as in folder names: without a colon, which Windows does not allow."""
        return self.recorded_traffic.replace(":", "-")


def check_conditions(conditions: TrafficConditions) -> None:
    """Raise InputError for an unknown platform, and for conditions that it cannot fly."""
    platform = conditions.platform
    check_platform(platform)
    if _is_undecodable(conditions.traffic):
        raise InputError(f"traffic {conditions.traffic}: the file name is not valid UTF-8")
    if is_fixed(conditions.traffic):
        _check_fixed(conditions)
        return
    if is_scenario(conditions.traffic):
        _check_scenario(conditions)
        return
    if platform != BLUEBIRD:
        return
    if conditions.traffic not in FLIGHT_SCHOOL:
        raise InputError(
            f"traffic {conditions.traffic} in BluebirdDT (allowed: {', '.join(FLIGHT_SCHOOL)}, or "
            f"{SPRINGFIELD}:SCENARIO)"
        )
    _refuse_options(conditions, f"--platform {platform}")


def _is_undecodable(name: str) -> bool:
    """Whether a file name is not valid UTF-8, so that it cannot be recorded in a file."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return True
    return False


def _check_scenario(conditions: TrafficConditions) -> None:
    if is_scenario_file(conditions.traffic):
        _check_one_hour(conditions)
        if conditions.seed:
            raise InputError(
                f"traffic {conditions.traffic} with seed {conditions.seed} (allowed: no seed; this "
                "traffic is always the same)"
            )
    _refuse_options(conditions, f"traffic {conditions.traffic}")


def _check_one_hour(conditions: TrafficConditions) -> None:
    if conditions.hours != 1:
        raise InputError(
            f"traffic {conditions.traffic} is the same in every hour (allowed: one hour, one seed)"
        )


def _check_fixed(conditions: TrafficConditions) -> None:
    traffic = conditions.traffic
    _check_one_hour(conditions)
    if conditions.platform not in (OWN, BLUEBIRD):
        raise InputError(
            f"traffic {traffic} with --platform {conditions.platform} (allowed: {OWN} or "
            f"{BLUEBIRD})"
        )
    _refuse_options(conditions, f"traffic {traffic}")


def _refuse_options(conditions: TrafficConditions, what: str) -> None:
    for option, given in (("sector", conditions.sector), ("uncertainty", conditions.uncertainty)):
        if given:
            raise InputError(f"--{option} cannot be used with {what}")


def flow_of(conditions: TrafficConditions, simulator: Simulator) -> Flow:
    """The arrivals of the named traffic. Raises InputError for unknown traffic."""
    traffic = conditions.traffic
    if traffic in FLIGHT_SCHOOL:
        flow = Flow(simulator, FLIGHT_SCHOOL[traffic], starters=STARTERS)
    else:
        flow = _constant_flow(traffic, simulator)
    if conditions.uncertainty:
        flow = replace(flow, speed_spread=SPEED_SPREAD, climb_spread=CLIMB_SPREAD)
    return replace(flow, cycles=conditions.cycles)


def is_named(traffic: str) -> bool:
    """Whether traffic has a name instead of a rate."""
    return traffic in FLIGHT_SCHOOL or is_fixed(traffic) or is_scenario(traffic)


def cycles_of(traffic: str, given: int | None = None) -> int:
    """The given length; by default that of an hour, or of a scenario.

    Raises InputError as `scenario_world` does.
    """
    if given is not None:
        return given
    return scenario_world(traffic).cycles if is_scenario(traffic) else HOUR_CYCLES


def traffic_name(traffic: str) -> str:
    """Traffic as it is written in rows: `60` for `60.0`, `category` for `flight-school`.

    Invalid traffic is left as it is.
    """
    traffic = ALIASES.get(traffic, traffic)
    try:
        return traffic if is_named(traffic) else f"{float(traffic):.15g}"
    except ValueError:
        return traffic


def _constant_flow(traffic: str, simulator: Simulator) -> Flow:
    try:
        rate = float(traffic)
    except ValueError:
        names = sorted({*FLIGHT_SCHOOL, *ALIASES, *experiment_names()})
        hint = suggestion(traffic, names, [traffic + SCENARIO_SUFFIX])
        raise InputError(
            f"unknown traffic {traffic!r}{hint} (allowed: flights per hour, "
            f"{', '.join(FLIGHT_SCHOOL)}, "
            f"{SPRINGFIELD}:SCENARIO, an experiment, or a scenario file ({SCENARIO_SUFFIX}))"
        ) from None
    clock = constant_rate(rate)
    # About a quarter of the flights of an hour are there at once.
    slots = next((each for each in _SLOTS if each >= 0.45 * rate + 8.0), _SLOTS[-1])
    return Flow(simulator, clock, slots=slots)
