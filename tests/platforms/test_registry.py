"""Platforms by name: what is missing is named, what must be said is said."""

import pytest

from skystack.errors import InputError, PlatformError
from skystack.platforms import registry
from skystack.platforms.guard import Guarded
from skystack.platforms.own import Skystack
from skystack.platforms.protocol import Platform
from skystack.platforms.registry import check_platform, flown_type, open_platform, said_of
from tests.scenarios import MINIMAL, load


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
    assert said_of("bluesky", ["B753", "A320"]) == ["bluesky has no B753: flown as B752"]
    assert said_of("bluebird") == said_of("skystack") == []
    assert flown_type("bluebird", "B753") == "B753"


class Broken(Skystack):
    """Ours, with a report that says too little."""

    def advance(self):
        return super().advance()._replace(fl=super().advance().fl[:1])


def test_a_report_that_is_not_whole_is_an_error(tmp_path):
    platform = Guarded(Broken)
    platform.reset(load(MINIMAL, tmp_path))
    with pytest.raises(PlatformError, match=r"reported \(1,\) of fl for 2"):
        platform.advance()
