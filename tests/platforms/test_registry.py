"""Platforms by name: what is missing is named, what must be said is said."""

import sys
from types import SimpleNamespace

import pytest

from skystack.errors import InputError, PlatformError
from skystack.platforms import registry
from skystack.platforms.adoption import BLUEBIRD, BLUESKY
from skystack.platforms.guard import Guarded
from skystack.platforms.own import Skystack
from skystack.platforms.protocol import Platform
from skystack.platforms.registry import (
    PLATFORMS,
    adoption_of,
    check_platform,
    flown_type,
    open_platform,
    platform_notes,
    scenario_notes,
)
from tests.scenarios import MINIMAL, changed, load


def test_our_own_needs_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr(registry, "_installed", lambda name: False)
    assert isinstance(open_platform("skystack", tmp_path), Platform)


@pytest.mark.parametrize(
    ("there", "message"),
    [
        ((), "needs bluesky-simulator and pebble, not installed here"),
        (("pebble",), "needs bluesky-simulator, not installed here"),
        (("bluesky-simulator",), "needs pebble, not installed here"),
    ],
)
def test_what_is_missing_is_named_with_its_extra(monkeypatch, there, message):
    monkeypatch.setattr(registry, "_installed", lambda name: name in there)
    with pytest.raises(InputError, match=message) as refused:
        check_platform("bluesky")
    assert "[bluesky]" in str(refused.value)


def test_the_type_that_is_flown_is_said():
    assert platform_notes("bluesky", ["B753", "A320"]) == ["bluesky has no B753: flown as B752"]
    assert platform_notes("bluebird") == platform_notes("skystack") == []
    assert flown_type("bluebird", "B753") == "B753"


class Broken(Skystack):
    """Ours, with a report that says too little."""

    def advance(self):
        return super().advance()._replace(fl=super().advance().fl[:1])


def test_a_report_that_is_not_whole_is_an_error(tmp_path):
    platform = Guarded(Broken)
    platform.reset(load(MINIMAL, tmp_path))
    with pytest.raises(PlatformError, match=r"reported fl of shape \(1,\) for 2 aircraft"):
        platform.advance()


def test_each_platform_has_its_own_adoption():
    """Ours and BluebirdDT fly the cycle first, and BluebirdDT alone ends a turn near its target."""
    found = {name: adoption_of(name) for name in PLATFORMS}
    assert {name: each.cycles for name, each in found.items()} == {
        "skystack": 1,
        "bluebird": 1,
        "bluesky": 0,
    }
    assert {name: each.snap_deg for name, each in found.items()} == {
        "skystack": 0.0,
        "bluebird": 1.5,
        "bluesky": 0.0,
    }


def test_an_unknown_platform_is_named_with_the_nearest():
    with pytest.raises(InputError, match="unknown platform 'blusky'; did you mean 'bluesky'"):
        check_platform("blusky")


def test_extras_are_named_for_each_platform(monkeypatch):
    monkeypatch.setattr(registry, "_installed", lambda name: False)
    with pytest.raises(InputError, match=r"needs bluebird-dt and pebble.*\[bluebird\]"):
        check_platform("bluebird")


CLIMB_NOTE = (
    "bluesky limits the speed of a climb or descent to the envelope of its type at the "
    "cleared level"
)


def test_climbs_are_noted_where_they_are_flown_otherwise():
    assert platform_notes("bluesky", ["A320"], climbs=True) == [CLIMB_NOTE]
    assert platform_notes("bluesky", ["A320", "A320"], climbs=False) == []
    assert platform_notes("bluebird", ["B753"], climbs=True) == []
    substitute = "bluesky has no B753: flown as B752"
    assert platform_notes("bluesky", ["B753", "A320", "B753"], climbs=True) == [
        substitute,
        CLIMB_NOTE,
    ]


def noted(folder, platform, **fields):
    """Notes of a scenario with an A320 and an AT76."""
    file = changed(("aircraft", 0, "type"), "AT76") | fields
    file["aircraft"][1]["type"] = "A320"
    return scenario_notes(platform, load(file, folder))


def test_speeds_of_types_without_any_of_their_own_are_noted(tmp_path):
    """Not of the simulator that flies a fleet, nor at constant speed, nor of the fleet's types."""
    assert noted(tmp_path, "bluebird") == [
        "bluebird flies A320 at the speeds of its own tables",
        "bluebird flies AT76 at the speeds of its own tables",
    ]
    assert noted(tmp_path, "bluesky", clearances=[]) == [
        "bluesky flies A320 at the speeds of B753",
        "bluesky flies AT76 at the speeds of B753",
    ]
    assert noted(tmp_path, "skystack") == []
    assert noted(tmp_path, "bluebird", performance="constant") == []
    both = [{"type": "AT76"}, {"type": "A320"}]
    assert noted(tmp_path, "bluebird", fleet=both) == []


def test_climbs_of_a_scenario_are_noted(tmp_path):
    up = [{"cycle": 1, "callsign": "AC1", "fl": 310}]
    assert noted(tmp_path, "bluesky", clearances=up)[0] == CLIMB_NOTE


def _takes_anything(self, *folder):
    pass


@pytest.mark.parametrize("name", PLATFORMS)
def test_a_name_opens_its_own_platform(name, monkeypatch, tmp_path):
    """The adapters of the others are exchanged for what only says that it was opened."""
    others = {"bluebird": ("Bluebird", BLUEBIRD), "bluesky": ("BlueSky", BLUESKY)}
    monkeypatch.setattr(registry, "_installed", lambda name: True)
    for other, (adapter, adoption) in others.items():
        other_one = type(adapter, (Skystack,), {"adoption": adoption, "__init__": _takes_anything})
        module = SimpleNamespace(**{adapter: other_one})
        monkeypatch.setitem(sys.modules, f"skystack.platforms.{other}", module)
    assert open_platform(name, tmp_path).adoption is adoption_of(name)


def test_only_bluesky_flies_another_type():
    flown = {name: flown_type(name, "B753") for name in PLATFORMS}
    assert flown == {"skystack": "B753", "bluebird": "B753", "bluesky": "B752"}
