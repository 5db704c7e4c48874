"""The registry of platforms: missing extras, unknown names and notes for the user."""

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


def test_skystack_needs_no_extra(monkeypatch, tmp_path):
    monkeypatch.setattr(registry, "_installed", lambda name: False)
    assert isinstance(open_platform("skystack", tmp_path), Platform)


@pytest.mark.parametrize(
    ("installed", "message"),
    [
        ((), "needs bluesky-simulator and pebble, which are not installed"),
        (("pebble",), "needs bluesky-simulator, which is not installed"),
        (("bluesky-simulator",), "needs pebble, which is not installed"),
    ],
)
def test_names_missing_packages_and_their_extra(monkeypatch, installed, message):
    monkeypatch.setattr(registry, "_installed", lambda name: name in installed)
    with pytest.raises(InputError, match=message) as error:
        check_platform("bluesky")
    assert "[bluesky]" in str(error.value)


def test_notes_the_substitute_type():
    assert platform_notes("bluesky", ["B753", "A320"]) == ["bluesky has no B753: flown as B752"]
    assert platform_notes("bluebird") == platform_notes("skystack") == []
    assert flown_type("bluebird", "B753") == "B753"


class Broken(Skystack):
    """Skystack with a report that lacks an aircraft."""

    def advance(self):
        return super().advance()._replace(fl=super().advance().fl[:1])


def test_incomplete_reports_are_errors(tmp_path):
    platform = Guarded(Broken)
    platform.reset(load(MINIMAL, tmp_path))
    with pytest.raises(PlatformError, match=r"reported fl of shape \(1,\) for 2 aircraft"):
        platform.advance()


def test_each_platform_has_its_own_adoption():
    """Skystack and BluebirdDT adopt after the cycle; only BluebirdDT snaps to a near heading."""
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


def test_suggests_the_nearest_platform_name():
    with pytest.raises(InputError, match="unknown platform 'blusky'; did you mean 'bluesky'"):
        check_platform("blusky")


def test_names_the_extra_of_bluebird(monkeypatch):
    monkeypatch.setattr(registry, "_installed", lambda name: False)
    with pytest.raises(InputError, match=r"needs bluebird-dt and pebble.*\[bluebird\]"):
        check_platform("bluebird")


CLIMB_NOTE = (
    "bluesky limits the speed of a climb or descent to the envelope of its type at the "
    "cleared level"
)


def test_notes_that_bluesky_limits_climb_speeds():
    assert platform_notes("bluesky", ["A320"], climbs=True) == [CLIMB_NOTE]
    assert platform_notes("bluesky", ["A320", "A320"], climbs=False) == []
    assert platform_notes("bluebird", ["B753"], climbs=True) == []
    substitute = "bluesky has no B753: flown as B752"
    assert platform_notes("bluesky", ["B753", "A320", "B753"], climbs=True) == [
        substitute,
        CLIMB_NOTE,
    ]


def notes_for(folder, platform, **fields):
    """The notes for a scenario with an A320 and an AT76."""
    file = changed(("aircraft", 0, "type"), "AT76") | fields
    file["aircraft"][1]["type"] = "A320"
    return scenario_notes(platform, load(file, folder))


def test_notes_speeds_of_types_outside_the_fleet(tmp_path):
    """No notes for skystack, at constant speed, or for the fleet's types."""
    assert notes_for(tmp_path, "bluebird") == [
        "bluebird flies A320 at the speeds of its own tables",
        "bluebird flies AT76 at the speeds of its own tables",
    ]
    assert notes_for(tmp_path, "bluesky", clearances=[]) == [
        "bluesky flies A320 at the speeds of B753",
        "bluesky flies AT76 at the speeds of B753",
    ]
    assert notes_for(tmp_path, "skystack") == []
    assert notes_for(tmp_path, "bluebird", performance="constant") == []
    members = [{"type": "AT76"}, {"type": "A320"}]
    assert notes_for(tmp_path, "bluebird", fleet=members) == []


def test_notes_climbs_of_a_scenario(tmp_path):
    climb = [{"cycle": 1, "callsign": "AC1", "fl": 310}]
    assert notes_for(tmp_path, "bluesky", clearances=climb)[0] == CLIMB_NOTE


def _ignore_arguments(self, *folder):
    pass


@pytest.mark.parametrize("name", PLATFORMS)
def test_opens_the_named_platform(name, monkeypatch, tmp_path):
    """The adapters of the other platforms are replaced by stubs with the same adoption."""
    others = {"bluebird": ("Bluebird", BLUEBIRD), "bluesky": ("BlueSky", BLUESKY)}
    monkeypatch.setattr(registry, "_installed", lambda name: True)
    for other, (adapter, adoption) in others.items():
        stub = type(adapter, (Skystack,), {"adoption": adoption, "__init__": _ignore_arguments})
        module = SimpleNamespace(**{adapter: stub})
        monkeypatch.setitem(sys.modules, f"skystack.platforms.{other}", module)
    assert open_platform(name, tmp_path).adoption is adoption_of(name)


def test_only_bluesky_substitutes_types():
    flown = {name: flown_type(name, "B753") for name in PLATFORMS}
    assert flown == {"skystack": "B753", "bluebird": "B753", "bluesky": "B752"}
