"""Sessions are opened under the conditions of an evaluation."""

from contextlib import closing

import pytest

from skystack.errors import InputError
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.live.recorded import open_session

FILE = "examples/head-on.json"


def test_an_agent_that_another_simulator_flies_cannot_advise():
    pytest.importorskip("bluesky")
    with pytest.raises(InputError, match=r"mvp cannot advise: .* \(allowed: any other agent\)"):
        open_session(TrafficConditions("60", platform="bluesky"), "mvp")


@pytest.mark.slow
def test_says_what_another_simulator_flies_differently():
    pytest.importorskip("bluesky")
    opened = open_session(TrafficConditions(FILE, platform="bluesky"))
    with closing(opened.hour):
        assert opened.notes[0] == "bluesky has no B753: flown as B752"
    opened = open_session(TrafficConditions(FILE))
    assert opened.notes == []
