"""The outlook of flights: when they would lose separation, as cleared and after other clearances.

Each flight is predicted (`skystack.tasks.prediction`) as cleared and after each of a few other
clearances, `WAYS`. All other flights are predicted as cleared. The outlook also has the time until
the flight would make an excursion (`skystack.tasks.leaving`).
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from skystack.airspace.sector import Sector
from skystack.compilation.chunks import in_chunks
from skystack.compilation.subroutine import subroutine
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import Traffic, ticks
from skystack.tasks.leaving import time_to_leaving
from skystack.tasks.pairwise_losses import (
    Cleared,
    Neighbours,
    Others,
    columns_of,
    others_of,
    times_to_loss,
)
from skystack.tasks.prediction import (
    HORIZON_S,
    TIMES_S,
    Flags,
    PredictedPath,
    Rows,
    path_along_route,
    path_as_cleared,
    path_on_heading,
    predicted_level,
)
from skystack.tasks.urgency import FAR, NEIGHBOURS, ScenarioFlights, by_scenario, most_urgent

TURNS_DEG = (-90.0, -60.0, -40.0, -20.0, -10.0, 10.0, 20.0, 40.0, 60.0, 90.0)
"""Turns from the cleared heading that are tried."""
CHANGES_FL = (-70.0, -40.0, -20.0, -10.0, 10.0, 20.0, 40.0, 70.0)
"""Changes of the cleared level that are tried."""
WAYS = (
    "cleared",
    "direct",
    *(f"turn {turn:+.0f}" for turn in TURNS_DEG),
    "exit level",
    *(f"level {change:+.0f}" for change in CHANGES_FL),
    "direct, exit level",
)
"""The clearances that are tried, each with one change, except the last."""
CLEARED = WAYS.index("cleared")
PATH_OF_WAY = np.array(
    [*range(2 + len(TURNS_DEG)), *[CLEARED] * (1 + len(CHANGES_FL)), WAYS.index("direct")]
)
"""The index of the lateral path of each of `WAYS`. Changes of level keep the path as cleared;
`direct, exit level` has that of `direct`."""
MARGIN_NM = 1.0
"""Added to the separation standard in what a policy observes."""

CHUNK = 128
"""Flights are predicted in chunks of this size."""


class Outlook(NamedTuple):
    """What is predicted for each flight. Times are in seconds, at most `HORIZON_S`."""

    time_s: Float[Array, "ways slots *batch"]
    """The time until separation would be lost after each clearance of `WAYS`."""
    leaves_s: Float[Array, "paths slots *batch"]
    """The time until the flight would make an excursion on each path that `PATH_OF_WAY` refers to;
    see `skystack.tasks.leaving`."""
    neighbour: Int[Array, "neighbours slots *batch"]
    """The slots of the other flights that matter most, the most urgent first."""
    urgency: Float[Array, "neighbours slots *batch"]
    """The lower, the more urgent; `FAR` for free slots."""
    neighbour_time_s: Float[Array, "neighbours slots *batch"]
    """The time until separation from each neighbour would be lost as cleared."""

    @property
    def exists(self) -> Bool[Array, "neighbours slots *batch"]:
        """Whether each neighbour is a flight."""
        return self.urgency < FAR


class Flights(NamedTuple):
    """Some flights, one per column, and what a prediction needs of them."""

    traffic: Traffic
    next_fix: Int[Array, " columns"]
    """The fix of a clearance direct."""
    exit_level_ticks: Float[Array, " columns"]
    entered: Bool[Array, " columns"]
    """Whether the flight has been inside the area."""


def look_ahead(
    simulator: Simulator,
    traffic: Traffic,
    next_fix: Int[Array, "slots *batch"],
    exit_level_ticks: Rows,
    entered: Flags,
    margin_nm: float = MARGIN_NM,
    flights: Flags | None = None,
    before: Outlook | None = None,
) -> Outlook:
    """The outlook of all active flights, or of some `flights`.

    `next_fix` is that of a clearance direct, and `margin_nm` is added to the separation standard.
    Other slots keep the outlook in `before`; without it, they have no conflicts and no neighbours.
    Flights are computed in chunks, so the work depends little on the number of free slots.
    """
    shape, batch = traffic.active.shape, _scenarios_in(traffic)
    everyone = _in_columns(Flights(traffic, next_fix, exit_level_ticks, entered))
    active = everyone.traffic.active
    others = _others_in_chunks(simulator, everyone)
    scenarios = by_scenario(everyone.traffic, others.cleared, batch)
    if before is None:
        before = no_outlook(shape)
    outlook = in_chunks(
        active if flights is None else flights.reshape(-1) & active,
        partial(_outlook_of, simulator, everyone, others, scenarios, margin_nm=margin_nm),
        Outlook(*(values.reshape(-1, *active.shape) for values in before)),
        CHUNK,
    )
    return Outlook(*(values.reshape(-1, *shape) for values in outlook))


def time_to_loss_as_cleared(
    simulator: Simulator,
    traffic: Traffic,
    next_fix: Int[Array, "slots *batch"],
    exit_level_ticks: Rows,
    entered: Flags,
    margin_nm: float = MARGIN_NM,
) -> Float[Array, "slots *batch"]:
    """`look_ahead(...).time_s[CLEARED]`, computed without the other ways."""
    everyone = _in_columns(Flights(traffic, next_fix, exit_level_ticks, entered))
    active, batch = everyone.traffic.active, _scenarios_in(traffic)
    others = _others_in_chunks(simulator, everyone)
    scenarios = by_scenario(everyone.traffic, others.cleared, batch)

    def time_s(column: Int[Array, " chosen"]) -> Float[Array, " chosen"]:
        sector, flights = simulator.sector, _chosen(everyone, column)
        neighbours = _neighbours(sector, flights, others, scenarios, column)[0]
        own = columns_of(others.cleared, column)
        path: PredictedPath = jax.tree.map(lambda each: each[..., None, :], own.path)
        found, _ = subroutine(
            partial(times_to_loss, sector, margin_nm, False),
            flights.traffic,
            path,
            own.level_ticks[:, None],
            others,
            neighbours,
        )
        return found[CLEARED]

    nothing = jnp.full(active.shape, HORIZON_S)
    return in_chunks(active, time_s, nothing, CHUNK).reshape(traffic.active.shape)


def no_outlook(shape: tuple[int, ...]) -> Outlook:
    """The outlook without conflicts and neighbours, for `[slots, *batch]`."""
    count = min(NEIGHBOURS, shape[0] - 1)
    return Outlook(
        time_s=jnp.full((len(WAYS), *shape), HORIZON_S),
        leaves_s=jnp.full((max(PATH_OF_WAY) + 1, *shape), HORIZON_S),
        neighbour=jnp.zeros((count, *shape), dtype=jnp.int32),
        urgency=jnp.full((count, *shape), FAR),
        neighbour_time_s=jnp.full((count, *shape), HORIZON_S),
    )


def look_ahead_for(
    simulator: Simulator,
    slot: Int[Array, ""],
    traffic: Traffic,
    next_fix: Int[Array, " slots"],
    exit_level_ticks: Float[Array, " slots"],
    entered: Bool[Array, " slots"],
) -> Outlook:
    """The outlook of one flight: its column of the result of `look_ahead`."""
    everyone = Flights(traffic, next_fix, exit_level_ticks, entered)
    cleared = subroutine(partial(_as_cleared, simulator), traffic)
    scenarios = by_scenario(traffic, cleared, batch=1)
    column = jnp.full(1, slot, dtype=jnp.int32)
    return _outlook_of(simulator, everyone, others_of(cleared), scenarios, column)


def _scenarios_in(traffic: Traffic) -> int:
    """The number of scenarios in a batch; 1 without batch axes."""
    return int(np.prod(traffic.active.shape[1:], dtype=int))


def _others_in_chunks(simulator: Simulator, everyone: Flights) -> Others:
    """All active flights as cleared. `everyone` is in columns."""
    active = everyone.traffic.active
    times = jnp.zeros((len(TIMES_S), *active.shape))
    return others_of(
        in_chunks(
            active,
            lambda column: _as_cleared(simulator, _chosen(everyone, column).traffic),
            Cleared(PredictedPath(times, times, times[0]), times),
            CHUNK,
        )
    )


def _in_columns(everyone: Flights) -> Flights:
    """The flights of a batch of scenarios as columns: for each slot, one column per scenario."""
    slots = everyone.traffic.active

    def flat(values: Array) -> Array:
        if values.ndim > slots.ndim:  # the second axis is that of coordinates
            return jnp.moveaxis(values, 1, -1).reshape(-1, values.shape[1])
        return values.reshape(-1)

    flights: Flights = jax.tree.map(flat, everyone)
    return flights


def _chosen(flights: Flights, column: Int[Array, " chosen"]) -> Flights:
    chosen: Flights = jax.tree.map(lambda values: values[column], flights)
    return chosen


def _as_cleared(simulator: Simulator, traffic: Traffic) -> Cleared:
    path = path_as_cleared(simulator.sector, traffic)
    level = predicted_level(simulator, traffic, traffic.cleared_level_ticks)
    return Cleared(path, level)


def _outlook_of(
    simulator: Simulator,
    everyone: Flights,
    others: Others,
    scenarios: ScenarioFlights,
    column: Int[Array, " chosen"],
    margin_nm: float = MARGIN_NM,
) -> Outlook:
    """The outlook of the flights in some columns."""
    sector, flights = simulator.sector, _chosen(everyone, column)
    traffic = flights.traffic
    # Subroutines, or else each result would be computed again wherever it is used.
    paths = subroutine(partial(_paths, sector), flights, columns_of(others.cleared.path, column))
    levels = subroutine(partial(_levels, simulator), flights)
    leaves_s = subroutine(partial(time_to_leaving, sector), traffic, flights.entered, paths)
    neighbours, neighbour, urgency = _neighbours(sector, flights, others, scenarios, column)
    time_s, neighbour_time_s = subroutine(
        partial(times_to_loss, sector, margin_nm, True),
        traffic,
        paths,
        levels,
        others,
        neighbours,
    )
    return Outlook(time_s, leaves_s, neighbour, urgency, neighbour_time_s)


def _neighbours(
    sector: Sector,
    flights: Flights,
    others: Others,
    scenarios: ScenarioFlights,
    column: Int[Array, " chosen"],
) -> tuple[Neighbours, Int[Array, "neighbours chosen"], Float[Array, "neighbours chosen"]]:
    """The most urgent neighbours of some flights, their slots, and their urgency."""
    slot, urgency = subroutine(
        partial(most_urgent, sector),
        scenarios,
        flights.traffic,
        others.cleared,
        flights.exit_level_ticks,
        column,
    )
    batch = scenarios.active.shape[0]
    return Neighbours(slot * batch + (column % batch)[None], urgency < FAR), slot, urgency


def _paths(sector: Sector, flights: Flights, cleared: PredictedPath) -> PredictedPath:
    """The paths as cleared, direct and after the turns, on an axis before the columns."""
    traffic, start = flights.traffic, jnp.zeros_like(flights.traffic.active)
    direct = path_along_route(sector, traffic, flights.next_fix, start)
    headings = traffic.cleared_heading_deg[None] + jnp.asarray(TURNS_DEG)[:, None]
    axes = PredictedPath(1, 1, 0)  # type: ignore[arg-type]  # those of the turns
    turned: PredictedPath = jax.vmap(partial(path_on_heading, sector, traffic), out_axes=axes)(
        headings
    )

    def joined(axis: int, cleared: Array, direct: Array, turned: Array) -> Array:
        return jnp.concatenate([jnp.stack([cleared, direct], axis), turned], axis)

    return PredictedPath(
        joined(1, cleared.east_nm, direct.east_nm, turned.east_nm),
        joined(1, cleared.north_nm, direct.north_nm, turned.north_nm),
        joined(0, cleared.until_s, direct.until_s, turned.until_s),
    )


def _levels(simulator: Simulator, flights: Flights) -> Float[Array, "times levels columns"]:
    """The levels after clearances to levels, in the order of `WAYS`; as cleared first."""
    cleared, exit_level = flights.traffic.cleared_level_ticks, flights.exit_level_ticks
    goals = jnp.stack([cleared, exit_level, *changed_levels(simulator.sector, cleared)])
    predicted = partial(predicted_level, simulator, flights.traffic)
    levels: Array = jax.vmap(predicted, out_axes=1)(goals)
    return levels


def changed_levels(sector: Sector, cleared_ticks: Rows) -> list[Rows]:
    """The cleared levels changed by each of `CHANGES_FL`, limited to those of the sector."""
    lowest, highest = (ticks(float(fl)) for fl in sector.levels_fl)
    return [jnp.clip(cleared_ticks + ticks(change), lowest, highest) for change in CHANGES_FL]
