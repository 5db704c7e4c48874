"""Why flights in BlueSky differ: skystack's simulator with properties of BlueSky, one by one.

Flies a policy with online action-stacking on the evaluation scenarios in BlueSky, in skystack, and
in skystack with turns at BlueSky's rate, with clearances effective immediately, on BlueSky's
sphere, and with several of these. Needs the extra `[bluesky]`.

    python -m studies.bluesky_difference [POLICY [SCENARIOS]]     default: lateral-tuned 100

Prints a JSON object per variant: clearances and success, the share of scenarios with the same
clearances as in BlueSky, and the distance of the aircraft from those in BlueSky, as the mean and
the 95th percentile over the rows of these scenarios.
"""

import json
import math
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from skystack.airspace.projection import geodesic_leg
from skystack.airspace.sector import LatLon
from skystack.errors import InputError
from skystack.evaluation.agreement import same_clearances
from skystack.evaluation.evaluate import policy_task
from skystack.evaluation.platform_rollout import Pilot, PlatformRollout
from skystack.evaluation.rollout import Recording, concatenate, network_controller
from skystack.evaluation.tables import Tables, make_tables
from skystack.platforms.instruction import Instruction
from skystack.platforms.own import Skystack
from skystack.platforms.protocol import Platform, Report
from skystack.platforms.registry import open_platform
from skystack.policies.shipped import find_policy
from skystack.simulator.scenario_file import Scenario
from skystack.simulator.simulator import adopt
from skystack.simulator.traffic import Traffic

STANDARD_GRAVITY_M_S2, BANK_DEG = 9.80665, 25.0
CRUISE_KT = 465.94
BANKED_DEG_S = math.degrees(
    STANDARD_GRAVITY_M_S2 * math.tan(math.radians(BANK_DEG)) / (CRUISE_KT * 1852.0 / 3600.0)
)
"""1.09 degrees per second: the rate of turn at 25 degrees of bank and cruising speed."""
SPHERE_M = 6_371_000.0
SPHERE_NM_PER_DEG = math.radians(SPHERE_M) / 1852.0


class Properties(NamedTuple):
    """The properties adopted from BlueSky."""

    turn_rate: bool = False
    at_once: bool = False
    sphere: bool = False


VARIANTS = {
    "skystack": Properties(),
    "turns at 25 degrees of bank": Properties(turn_rate=True),
    "clearances effective immediately": Properties(at_once=True),
    "BlueSky's sphere": Properties(sphere=True),
    "turns and immediate clearances": Properties(turn_rate=True, at_once=True),
    "all three": Properties(True, True, True),
}


def _degree_nm(at: LatLon) -> Float[np.ndarray, "2"]:
    """Length [NM] of a degree on the ellipsoid: east, divided by the cosine of latitude; north."""
    lat, lon = at
    east = geodesic_leg((lat, lon - 0.5), (lat, lon + 0.5))[1] / math.cos(math.radians(lat))
    return np.array([east, geodesic_leg((lat - 0.5, lon), (lat + 0.5, lon))[1]])


class WithProperties(Skystack):
    """Skystack's simulator with some of BlueSky's properties."""

    def __init__(self, properties: Properties) -> None:
        super().__init__()
        self._properties = properties

    def reset(self, scenario: Scenario) -> Report:
        """As in skystack, but with the properties compiled in."""
        if self._advance is None:
            simulator = scenario.simulator()
            if self._properties.turn_rate:
                simulator = replace(simulator, turn_rate_deg_s=BANKED_DEG_S)
            scale = _degree_nm(scenario.sector.origin) / SPHERE_NM_PER_DEG
            scale_nm = jnp.asarray(scale if self._properties.sphere else np.ones(2), jnp.float32)
            self._simulator = scenario.simulator()

            def advance(traffic: Traffic) -> Traffic:
                flown = simulator.advance(traffic)
                moved = (flown.position_nm - traffic.position_nm) * scale_nm
                return flown._replace(position_nm=traffic.position_nm + moved)

            self._advance = jax.jit(advance)
        return super().reset(scenario)

    def issue(self, instruction: Instruction) -> None:
        """As in skystack, or adopted before the cycle is flown."""
        super().issue(instruction)
        if self._properties.at_once:
            self._traffic = adopt(self._traffic)


def _with_properties(properties: Properties, folder: Path) -> Platform:
    return WithProperties(properties)


def flights(job: PlatformRollout, scenarios: int) -> Iterator[Recording]:
    """Fly the scenarios one after another in this process."""
    with tempfile.TemporaryDirectory() as folder:
        pilot = Pilot(job, Path(folder))
        for number in range(scenarios):
            yield pilot.fly(number)


def apart_nm(ours: Tables, theirs: Tables, same: list[bool]) -> tuple[float, float]:
    """Mean and 95th percentile of the distance between flights with the same clearances."""
    keys = ["scenario", "cycle", "callsign"]
    columns = [*keys, "lat", "lon", "status"]
    joined = ours.trajectories.select(columns).join(
        theirs.trajectories.select(columns), keys, right_suffix="_theirs", join_type="inner"
    )
    rows = {name: joined[name].to_numpy() for name in joined.column_names}
    counts = np.array(same)[rows["scenario"]]
    counts &= (rows["status"] != "exited") & (rows["status_theirs"] != "exited")
    distance = 60.0 * np.hypot(rows["lat"] - rows["lat_theirs"], rows["lon"] - rows["lon_theirs"])
    if not counts.any():
        return math.nan, math.nan
    return float(distance[counts].mean()), float(np.percentile(distance[counts], 95))


def main(arguments: list[str]) -> int:
    """Measure and print; returns the exit code."""
    name, scenarios = [*arguments, *["lateral-tuned", "100"][len(arguments) :]]
    try:
        policy = find_policy(name)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    task = policy_task(policy)
    controller = partial(network_controller, policy.actor, policy.normaliser, True)

    def flown(open_one: Callable[[Path], Platform]) -> Tables:
        job = PlatformRollout(task, controller, True, 0, open_one)
        return make_tables(task, concatenate(list(flights(job, int(scenarios)))))

    theirs = flown(partial(open_platform, "bluesky"))
    found = {"BlueSky": theirs}
    for variant, properties in VARIANTS.items():
        found[variant] = flown(partial(_with_properties, properties))
    for variant, tables in found.items():
        same = same_clearances(tables.clearances, theirs.clearances, range(int(scenarios)))
        mean, most = apart_nm(tables, theirs, same)
        line = {
            "variant": variant,
            "clearances": float(np.mean(tables.episodes["clearances"])),
            "success": float(np.mean(tables.episodes["success"])),
            "same_clearances": sum(same) / len(same),
            "apart_nm_mean": round(mean, 3),
            "apart_nm_95": round(most, 3),
        }
        sys.stdout.write(json.dumps(line) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
