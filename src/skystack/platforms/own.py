"""Skystack's own simulator behind the platform protocol, one compiled cycle at a time."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from skystack.compilation.shared import shared_program
from skystack.platforms.adoption import SKYSTACK
from skystack.platforms.instruction import Instruction
from skystack.platforms.protocol import Report, check_types
from skystack.simulator.scenario_file import Scenario
from skystack.simulator.simulator import Simulator, instruct
from skystack.simulator.traffic import (
    DIRECT,
    LEFT,
    NO_TURN,
    RIGHT,
    SHORTEST,
    Clearance,
    Traffic,
    ticks,
    trajectory_columns,
)


class Skystack:
    """Implements `skystack.platforms.protocol.Platform`; flies the types of the scenario's fleet.

    Without a fleet the only type is B753: the table is that of BluebirdDT's MEDIUM class.
    """

    adoption = SKYSTACK

    def __init__(self) -> None:
        self._scenario: Scenario
        self._traffic: Traffic
        self._simulator: Simulator | None = None
        self._advance: Any = None

    def reset(self, scenario: Scenario) -> Report:
        simulator = scenario.simulator()
        known = simulator.performance.types
        check_types(scenario, known, "skystack", ", ".join(known))
        if simulator != self._simulator:
            self._simulator, self._advance = simulator, shared_program(simulator.advance)
        self._scenario, self._traffic = scenario, scenario.initial_traffic(simulator)
        return self._report()

    def issue(self, instruction: Instruction) -> None:
        one = np.array([a.callsign == instruction.callsign for a in self._scenario.aircraft])
        turn = NO_TURN
        if instruction.heading_deg is not None:
            turn = {"left": LEFT, "right": RIGHT}[instruction.turn or "left"]
            turn = turn if instruction.by_direction else SHORTEST
        fix = 0
        if instruction.direct_to is not None:
            route = self._scenario.aircraft[int(np.argmax(one))].route
            turn, fix = DIRECT, route.index(instruction.direct_to)
        changes_level = instruction.level_fl is not None
        clearance = Clearance(
            turn=jnp.asarray(np.where(one, turn, NO_TURN).astype(np.int32)),
            heading_deg=jnp.full(len(one), float((instruction.heading_deg or 0) % 360)),
            changes_level=jnp.asarray(one & changes_level),
            level_ticks=jnp.full(len(one), ticks(float(instruction.level_fl or 0))),
            fix=jnp.full(len(one), fix, dtype=jnp.int32),
        )
        self._traffic = instruct(self._traffic, clearance)

    def advance(self) -> Report:
        self._traffic = self._advance(self._traffic)
        return self._report()

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def _report(self) -> Report:
        return Report(**trajectory_columns(self._traffic, self._scenario.sector.plane))
