"""The search, against flights with the small turns of the task and against brute force."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.airspace.sector import Sector
from skystack.airspace.xplus import x_plus
from skystack.learning.seeds import scenario_key
from skystack.simulator.generator import LateralScenarios
from skystack.simulator.performance import ConstantPerformance
from skystack.simulator.simulator import Simulator
from skystack.simulator.traffic import start, ticks
from skystack.tasks.actions import small_turns
from skystack.tasks.navigation import NavigationTask
from skystack.tasks.registry import build_task
from skystack.tasks.settings import NavigationSettings
from studies import fewest_clearances

STRAIGHT = {
    ("HERON", "CRANE", "EGL", "MACAW", "QUAIL", "SWIFT"),
    ("SWIFT", "QUAIL", "MACAW", "EGL", "CRANE", "HERON"),
}
DEFAULT_LIMIT = 18
"""The most instructions of a stack: half a turn."""


def refly(task):
    """A function that flies plans through the task's own interface, with bursts of small turns.

    It takes the initial traffic and the actions to issue in each cycle. It returns whether the
    scenario terminated, and the metrics at its end.
    """

    def cycle(state, actions):
        instructed = jax.lax.scan(
            lambda now, action: (task.instruct(now, action), None), state, actions
        )
        return task.advance(instructed[0])

    def fly(traffic, actions):
        _, outcomes = jax.lax.scan(cycle, task.begin(traffic), actions)
        ended = jnp.argmax(outcomes.terminated)
        return outcomes.terminated[ended], jax.tree.map(lambda x: x[ended], outcomes.metrics)

    return jax.jit(jax.vmap(fly, in_axes=(None, 0)))


def schedule(task, plans):
    """The small turns `[cycles, instructions]` of one plan per aircraft; 0 is the no-op."""
    slots = DEFAULT_LIMIT
    actions = np.zeros((task.cycles, len(plans) * slots), dtype=np.int32)
    for aircraft, plan in enumerate(plans):
        for turn in plan:
            begin, count = aircraft * slots, abs(turn.turn_deg) // 10
            actions[turn.cycle, begin : begin + count] = 1 + 2 * aircraft + (turn.turn_deg > 0)
    return actions


@pytest.fixture(scope="module")
def x_plus_search():
    return fewest_clearances.Search(build_task(NavigationSettings(aircraft=1)))


@pytest.fixture(scope="module")
def drawn():
    """The first four scenarios of seed 0, with each aircraft separate."""
    return fewest_clearances.draw(build_task(NavigationSettings()), seed=0, scenarios=4)


@pytest.fixture(scope="module")
def staircase():
    """A task in a Z of three corridors 8 NM wide: east, north at x = 16, east again at y = 26.

    No straight line leads from the first corridor to the exit: from the lower left corner of the
    second, (12, 0), the inner corner (20, 22) allows a slope of 8 in 22, which leads out through
    the top at x = 23, nine miles short of the exit at x = 32.
    """
    corners = [(0, 0), (20, 0), (20, 22), (32, 22), (32, 30), (12, 30), (12, 8), (0, 8)]
    fixes = {"START": (-5, 4), "EXIT": (32, 26), "END": (37, 26)}
    sector = Sector(
        name="staircase",
        origin=(0.0, 0.0),
        area=tuple((y / 60, x / 60) for x, y in corners),
        levels_fl=(200, 400),
        fixes={name: (y / 60, x / 60) for name, (x, y) in fixes.items()},
        routes=(("START", "EXIT", "END"),),
    )
    simulator = Simulator(sector, ConstantPerformance())
    settings = NavigationSettings(aircraft=1, cycles=75)
    return NavigationTask(settings, simulator, LateralScenarios(simulator, 1), small_turns(1))


@pytest.fixture(scope="module")
def staircase_search(staircase):
    return fewest_clearances.Search(staircase)


def one_aircraft(position_nm, heading_deg, route=0):
    return start(
        position_nm=jnp.asarray([position_nm], dtype=jnp.float32),
        heading_deg=jnp.asarray([heading_deg], dtype=jnp.float32),
        level_ticks=jnp.full(1, ticks(300)),
        route=jnp.asarray([route], dtype=jnp.int32),
        ground_speed_kt=jnp.full(1, 400.0),
        own_navigation=jnp.zeros(1, dtype=bool),
    )


@pytest.mark.slow
@pytest.mark.parametrize("route", x_plus().routes, ids="-".join)
def test_only_bent_routes_need_a_clearance(x_plus_search, route):
    sector = x_plus()
    heading = sector.first_heading_deg(route)
    traffic = one_aircraft(sector.fixes_nm[route[0]], heading, sector.routes.index(route))
    plan = x_plus_search.fewest(traffic, most=1)
    assert plan is not None
    assert len(plan) == (0 if route in STRAIGHT else 1)


@pytest.mark.slow
def test_plans_of_single_aircraft_succeed_together(x_plus_search, drawn):
    task = build_task(NavigationSettings())
    fly = refly(task)
    for scenario in drawn:
        plans = [x_plus_search.fewest(traffic, most=1) for traffic in scenario]
        both = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), *scenario)
        ended, metrics = fly(both, schedule(task, plans)[None])
        assert ended.all()
        assert metrics["success"].all()
        assert metrics["bursts"] == sum(len(plan) for plan in plans)


def test_scenarios_are_those_of_an_evaluation(drawn):
    expected = jax.jit(build_task(NavigationSettings()).scenarios.draw)(
        scenario_key(0, 2)
    ).traffic.position_nm
    found = np.concatenate([aircraft.position_nm for aircraft in drawn[2]])
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.slow
def test_one_clearance_agrees_with_brute_force(staircase, staircase_search):
    """Northbound in the second corridor: every stack in every cycle is flown."""
    traffic = one_aircraft((16.0, 12.0), 0.0)
    fly = refly(staircase)
    path, flying = staircase_search.fly(staircase.begin(traffic))
    # At 400 / 600 NM a cycle, the 18 NM to the top take 27 cycles, within 0.01 NM.
    assert int(flying) in (27, 28)
    batch = fewest_clearances.BATCH_CYCLES
    found = np.concatenate(
        [staircase_search.one_clearance(path, first) for first in range(0, int(flying), batch)]
    )
    expected = np.zeros_like(found)
    for cycle in range(int(flying)):
        plans = [
            [(fewest_clearances.Turn(cycle, action.change),)]
            for action in fewest_clearances.TURNS.actions[1:]
        ]
        ended, metrics = fly(traffic, np.stack([schedule(staircase, plan) for plan in plans]))
        assert ended.all()
        expected[cycle] = metrics["success"]
    np.testing.assert_array_equal(found, expected)
    assert expected.any()


@pytest.mark.slow
def test_a_staircase_needs_two_clearances(staircase, staircase_search):
    traffic = one_aircraft((8.0, 4.0), 90.0)
    assert staircase_search.fewest(traffic, most=1) is None
    plan = staircase_search.fewest(traffic, most=2)
    assert len(plan) == 2
    assert plan[0].cycle < plan[1].cycle
    ended, metrics = refly(staircase)(traffic, schedule(staircase, [plan])[None])
    assert ended.all()
    assert metrics["success"].all()
    assert metrics["bursts"] == 2


def test_rejects_a_task_of_two_aircraft():
    with pytest.raises(ValueError, match="a task of 2 aircraft"):
        fewest_clearances.Search(build_task(NavigationSettings()))


@pytest.fixture
def compiled_once(monkeypatch, x_plus_search):
    """Reuse the compiled search in the command line, which builds the same one."""
    monkeypatch.setattr(fewest_clearances, "Search", lambda task: x_plus_search)


@pytest.mark.slow
@pytest.mark.usefixtures("compiled_once")
def test_command_line_counts_the_aircraft_on_bent_routes(capsys, tmp_path, drawn):
    file = tmp_path / "fewest.json"
    assert fewest_clearances.main(["--scenarios", "3", "--json", "-o", str(file)]) == 0
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert json.loads(file.read_text()) == result
    assert "searching" in printed.err
    routes = [
        [x_plus().routes[int(traffic.route[0])] for traffic in scenario] for scenario in drawn
    ]
    bent = [sum(route not in STRAIGHT for route in scenario) for scenario in routes[:3]]
    assert result["per_scenario"] == bent
    assert result["clearances_mean"] == pytest.approx(sum(bent) / 3)
    assert (result["scenarios"], result["seed"]) == (3, 0)
    assert result["wall_s"] > 0.0


@pytest.mark.usefixtures("compiled_once")
def test_fails_if_more_clearances_are_needed_than_tried(capsys, monkeypatch):
    monkeypatch.setattr(fewest_clearances, "MOST", 0)
    assert fewest_clearances.main(["--scenarios", "2"]) == 1
    printed = capsys.readouterr()
    assert "needs more than 0 clearances" in printed.err
    assert printed.out == ""


def test_narrow_exits_are_searched(monkeypatch):
    """The search itself is not repeated: it flies whatever task it is given."""
    searched = []

    class Found:
        def __init__(self, task):
            searched.append(task)

        def fewest(self, traffic, most):
            return ()

    monkeypatch.setattr(fewest_clearances, "Search", Found)
    assert fewest_clearances.main(["--scenarios", "1", "--exit-nm", "5"]) == 0
    (task,) = searched
    whole = x_plus().route_table.exit_edge_nm
    exits = task.sector.route_table.exit_edge_nm
    widths = [np.linalg.norm(edges[:, 0] - edges[:, -1], axis=1) for edges in (whole, exits)]
    assert widths[0] == pytest.approx(20.0, abs=0.2)
    assert widths[1] == pytest.approx(10.0, abs=0.01)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scenarios", "0"], "--scenarios is 0 (allowed: 1 or more)"),
        (["--seed", "-1"], "--seed is -1 (allowed: 0 to 4294967295)"),
        (["--exit-nm", "0"], "--exit-nm is 0.0 (allowed: 0.1 to 50)"),
        (["-o", "nowhere/fewest.json"], "-o nowhere/fewest.json: there is no folder nowhere"),
    ],
)
def test_rejects_wrong_input_in_one_line(capsys, arguments, message):
    assert fewest_clearances.main(arguments) == 2
    assert capsys.readouterr().err == f"error: {message}\n"
