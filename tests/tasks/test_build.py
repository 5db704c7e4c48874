"""Building tasks from settings: the resulting tasks, the limits and refused settings."""

from itertools import pairwise

import msgspec
import pytest

from skystack.airspace.xplus import x_plus
from skystack.errors import InputError
from skystack.learning.experiment import load_experiment
from skystack.simulator.fleet import AircraftType
from skystack.tasks.actions import large_turns, level_changes, small_turns
from skystack.tasks.navigation import NavigationTask
from skystack.tasks.registry import build_task, build_training_task, check_cycles
from skystack.tasks.sector_control import SectorControl
from skystack.tasks.sector_kind import SectorSettings
from skystack.tasks.sector_stacks import SectorStacks
from skystack.tasks.settings import NavigationSettings, RewardSettings
from skystack.tasks.stacked_steps import StackedSteps

VERTICAL = {"name": "vertical", "aircraft": 1, "actions": "levels", "levels_fl": (100, 300)}


def build(**settings):
    return build_task(NavigationSettings(**settings))


def test_settings_determine_the_task():
    lateral, vertical = build(), build(**VERTICAL)
    assert lateral.table == small_turns(2)
    assert build(actions="large", aircraft=3).table == large_turns(3)
    assert vertical.table == level_changes(1, (100, 300))
    assert vertical.sector.levels_fl == (100, 300)
    assert (lateral.sector.levels_fl, lateral.sector.name) == ((200, 400), "x-plus")
    assert (lateral.simulator.own_navigation, vertical.simulator.own_navigation) == (False, True)
    scenarios = build(aircraft=3, level_fl=(300, 320), disc_nm=2.0).scenarios
    assert (scenarios.aircraft, scenarios.levels_fl, scenarios.disc_nm) == (3, (300, 320), 2.0)
    assert lateral.scenarios.levels_fl == (300,)


def test_timing_stack_trains_with_frozen_time():
    assert type(build_training_task(NavigationSettings())) is NavigationTask
    frozen = build_training_task(NavigationSettings(timing="stack"))
    assert isinstance(frozen, StackedSteps)
    assert frozen.task == build_task(NavigationSettings(timing="stack"))
    # Names, version and sector are those of the wrapped task.
    same = ("name", "version", "action_names", "observation_names", "sector")
    assert [getattr(frozen, name) for name in same] == [getattr(frozen.task, name) for name in same]


def test_timing_stack_trains_sector_control_in_rounds():
    assert type(build_training_task(SectorSettings())) is SectorControl
    rounds = build_training_task(SectorSettings(timing="stack"))
    assert isinstance(rounds, SectorStacks)
    assert rounds.agents == rounds.task.agents


@pytest.mark.parametrize(
    "settings",
    [
        {"aircraft": 4},  # x-plus has four first fixes
        {"level_fl": 200},
        {"level_fl": (200, 400)},
        {"levels_fl": (0, 600), "level_fl": 600},
        {"levels_fl": (0, 10), "level_fl": (0, 10)},
        {"fleet": (AircraftType("A320"),)},
    ],
)
def test_accepts_settings_at_their_limits(settings):
    build(**settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"aircraft": 5}, r"task\.aircraft is 5, but .* x-plus has 4 \(the default is 2"),
        ({"level_fl": 190}, r"task\.level_fl is 190 \(allowed in x-plus: .* from 200 to 400;"),
        ({"level_fl": 410}, r"task\.level_fl is 410"),
        ({"level_fl": 305}, r"task\.level_fl is 305"),
        ({"level_fl": (300, 410)}, r"task\.level_fl is 410"),
        ({"levels_fl": (-10, 300)}, r"task\.levels_fl is \[-10, 300\]"),
        ({"levels_fl": (100, 610)}, r"task\.levels_fl is \[100, 610\]"),
        ({"levels_fl": (105, 300)}, r"task\.levels_fl is \[105, 300\]"),
        ({"levels_fl": (100, 305)}, r"task\.levels_fl is \[100, 305\]"),
        ({"levels_fl": (300, 300)}, r"task\.levels_fl is \[300, 300\]"),
        ({"performance": "constant", "fleet": (AircraftType("A320"),)}, r"with task\.fleet: table"),
        ({"actions": "levels"}, r"allowed for lateral: small, large"),
        (VERTICAL | {"actions": "large"}, r"allowed for vertical: levels"),
        (VERTICAL | {"aircraft": 2}, r"task\.aircraft is 2"),
        ({"features": ("d_c", "room_")}, r"feature in task\.features.*did you mean 'room'"),
        ({"pair_features": ("mis",)}, r"feature in task\.pair_features.*did you mean 'miss'"),
    ],
)
def test_refuses_invalid_settings(settings, message):
    with pytest.raises(InputError, match=message):
        build(**settings)


def test_scenarios_use_the_shares_of_the_fleet():
    fleet = (AircraftType("A320", share=3.0), AircraftType("B753"))
    assert build(fleet=fleet).scenarios.shares == (3.0, 1.0)
    assert build().scenarios.shares == (1.0,)
    assert build(**VERTICAL, fleet=fleet).scenarios.shares == (3.0, 1.0)


def test_refuses_fewer_cycles_than_the_shortest_route_takes():
    """From 4 NM after the first fix to the exit fix at 465.94 kt, which is 0.7766 NM per cycle."""
    lengths = {}
    for route in x_plus().routes:
        fixes = [x_plus().fixes_nm[name] for name in route[:-1]]
        lengths[route] = sum(((a - b) ** 2).sum() ** 0.5 for a, b in pairwise(fixes))
    shortest = min(lengths, key=lengths.get)
    needed = int(-(-(lengths[shortest] - 4.0) // (465.940793 / 600.0)))
    with pytest.raises(InputError, match=f"{' '.join(shortest)}, takes {needed} at 466 kt"):
        check_cycles(build(cycles=needed - 1))
    notice = check_cycles(build(cycles=needed))
    assert notice is not None
    assert "of 10 routes take more than" in notice
    assert check_cycles(build()) is None


RANGES = [
    ("aircraft", 1, 200),
    ("disc_nm", 0.0, 50.0),
    ("cycles", 1, 10_000),
]


@pytest.mark.parametrize(("name", "least", "most"), RANGES)
def test_ranges_of_settings(name, least, most):
    for value in (least, most):
        assert getattr(msgspec.convert({name: value}, NavigationSettings), name) == value
    for value in (least - 1, most + 1):
        with pytest.raises(msgspec.ValidationError, match=name):
            msgspec.convert({name: value}, NavigationSettings)


@pytest.mark.parametrize("field", msgspec.structs.fields(RewardSettings), ids=lambda f: f.name)
def test_ranges_of_reward_settings(field):
    if field.name == "count_criterion":
        return
    most = 100.0 if field.name.endswith("_nm") else 1000.0
    for value in (0.0, most):
        assert getattr(msgspec.convert({field.name: value}, RewardSettings), field.name) == value
    for value in (-0.1, most + 0.1):
        with pytest.raises(msgspec.ValidationError, match=field.name):
            msgspec.convert({field.name: value}, RewardSettings)


def test_defaults_are_those_of_the_paper():
    """The weights and scenarios of lateral navigation; rewards that we added are off."""
    assert msgspec.to_builtins(RewardSettings()) == {
        "centreline": 1.0,
        "damping": 0.25,
        "terminal": 1.0,
        "count_criterion": True,
        "safety": 0.0,
        "vertical": 0.0,
        "burst": 0.0,
        "leg": 0.0,
        "shared_damping": 0.0,
        "outside_band": 0.0,
        "band_nm": 0.0,
        "excursion": 0.0,
        "conflict": 0.0,
        "conflict_nm": 5.5,
    }
    settings = NavigationSettings()
    assert (settings.aircraft, settings.level_fl, settings.disc_nm) == (2, 300, 4.0)
    assert (settings.cycles, settings.actions, settings.timing) == (300, "small", "cycle")
    assert settings.features == ("theta_f", "theta_sf", "d_c", "delta_t")
    assert (settings.sector, settings.performance) == ("x-plus", "table")


@pytest.mark.parametrize(
    ("name", "entry", "least", "most"),
    [("level_fl", 300, 1, 61), ("fleet", {}, 0, 20)],
)
def test_limits_of_list_lengths(name, entry, least, most):
    for count in (least, most):
        values = msgspec.convert({name: [entry] * count}, NavigationSettings)
        assert len(getattr(values, name)) == count
    for count in {least - 1, most + 1} - {-1}:
        with pytest.raises(msgspec.ValidationError, match=name):
            msgspec.convert({name: [entry] * count}, NavigationSettings)


@pytest.mark.parametrize("kind", [NavigationSettings, RewardSettings])
def test_refuses_unknown_settings(kind):
    with pytest.raises(msgspec.ValidationError, match="unknown field"):
        msgspec.convert({"surprise": 1}, kind)


@pytest.mark.parametrize("settings", ["lateral", load_experiment("lateral")])
def test_refuses_settings_of_a_wrong_type(settings, types_unchecked):
    with pytest.raises(InputError, match=r"^settings is of type \w+ \(allowed: TaskSettings"):
        build_task(settings)
