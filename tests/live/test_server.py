"""The server: who is let in, what browsers are told, and what is refused."""

import json
from threading import Event

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from skystack.errors import InputError
from skystack.live import server
from skystack.live.serving import LOOPBACK, bound_socket

from ..waiting import TIMEOUT_S
from .made import on_frequency
from .serving import COOKIE, TOKEN, served


@pytest.fixture(scope="module")
def session():
    with served(steps=60) as found:
        yield found


@pytest.mark.slow
def test_the_link_leads_to_the_page_and_hides_the_token(session):
    status, headers, _ = session.get(f"/?token={TOKEN}")
    assert (status, headers["location"]) == (303, "/")
    cookie = headers["set-cookie"]
    assert cookie.startswith(f"{COOKIE}={TOKEN};")
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    status, headers, page = session.get("/", Cookie=f"{COOKIE}={TOKEN}")
    assert status == 200
    assert TOKEN not in page
    assert "connect-src &#39;self&#39;" in page
    assert headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        ("/", {}),
        ("/?token=", {}),
        ("/?token=another", {}),
        ("/", {"Cookie": f"{COOKIE}=another"}),
        ("/", {"Cookie": f"{COOKIE}=é"}),
        ("/", {"Cookie": f"another={TOKEN}"}),
    ],
)
def test_nobody_sees_the_page_without_the_token(session, path, headers):
    encoded = {name: value.encode().decode("latin-1") for name, value in headers.items()}
    status, _, text = session.get(path, **encoded)
    assert status == 403
    assert text == "Open the link that `skystack session` printed.\n"


@pytest.mark.parametrize(
    "wrong",
    [
        {"cookie": "another"},
        {"cookie": ""},
        {"origin": "http://example.org"},
        {"origin": "null"},
        {"origin": f"http://{LOOPBACK}:1"},
        {"host": "example.org"},
    ],
)
def test_nobody_connects_without_the_token_or_from_another_origin(session, wrong):
    with pytest.raises((InvalidStatus, ConnectionClosed)), session.client(**wrong) as client:
        client.receive()


def test_another_host_name_is_refused(session):
    """A name that was made to resolve to this machine is not ours (DNS rebinding)."""
    status, _, _ = session.get("/", Host="example.org", Cookie=f"{COOKIE}={TOKEN}")
    assert status == 400


def test_a_page_gets_everything_then_only_what_is_new(session):
    control = session.control
    with session.client() as client:
        client.wait(lambda each: each.updates)
        assert client.updates == json.loads(json.dumps(control.history.updates))
        count = len(client.updates)
        client.send(do="step")
        client.wait(lambda each: len(each.updates) > count)
        assert client.updates[-1]["cycle"] == control.cycle
        epoch = client.epoch
    with session.client(epoch=epoch, known=[None] * count) as client:  # the connection was lost
        client.wait(lambda each: len(each.updates) > count)
        assert client.updates[count]["cycle"] == control.cycle


def test_two_browsers_see_one_session(session):
    with session.client() as one, session.client() as other:
        for each in (one, other):
            each.wait(lambda client: client.updates)
        name = on_frequency(session.control.hour)[0]
        reply = one.ask(do="clear", text=f"{name} left 10 degrees")
        assert reply["read_back"].endswith(f", {name}")
        other.wait(lambda client: "clearances" in client.updates[-1])
        assert other.updates[-1]["by"] == "you"


def test_runs_and_pauses_at_the_chosen_speed(session):
    with session.client() as client:
        client.send(do="speed", times=60)
        begin = session.control.cycle
        client.send(do="play", on=True)
        client.wait(lambda each: each.news and each.news["status"]["cycle"] >= begin + 5)
        client.send(do="play", on=False)
        client.wait(lambda each: not each.news["status"]["playing"])
        cycle = session.control.cycle
        assert client.news["status"]["speed"] == 60
        flown = [each["cycle"] for each in client.updates if "cycle" in each]
        assert flown == list(range(1, cycle + 1))  # none is missing


@pytest.mark.slow
def test_a_change_of_the_speed_takes_effect_at_once(monkeypatch):
    """Here a cycle takes longer in real time than any test waits, and a sixtieth of that at 60x."""
    monkeypatch.setattr(server, "CYCLE_S", 1.1 * TIMEOUT_S)
    with served(steps=1) as session, session.client() as client:
        client.send(do="play", on=True)
        client.wait(lambda each: each.news and each.news["status"]["playing"])
        client.send(do="speed", times=60)
        client.wait(lambda each: each.news["status"]["cycle"] == 2)


def test_an_adviser_that_fails_pauses_the_session():
    with served(steps=40) as session:

        def fail(state):
            raise RuntimeError("no\nidea")

        session.control._delegate.transmit = fail
        with session.client() as client:
            client.send(do="hand_over", callsigns=[], to_adviser=True)
            client.send(do="speed", times=60)
            client.send(do="play", on=True)
            client.wait(lambda each: each.news and each.news["problem"])
            assert client.news["problem"] == "Paused: RuntimeError: no\\nidea"
            assert not client.news["status"]["playing"]
            assert session.control.cycle == 40
            client.send(do="hand_over", callsigns=[], to_adviser=False)
            client.send(do="play", on=True)  # goes on without it
            client.wait(lambda each: each.news["status"]["cycle"] >= 42)
            assert client.news["problem"] is None


def test_trials_levels_and_advice_are_answered(session):
    name = on_frequency(session.control.hour)[0]
    with session.client() as client:
        assert client.ask(do="trial", text=f"{name} fly heading 360")["trial"]["callsign"] == name
        choices = client.ask(do="choices", callsign=name)
        assert len(choices["levels"]) == 21
        slot = session.control.hour.slots[name]
        assert tuple(choices["fixes"]) == session.control.hour.fixes_ahead(slot)
        assert client.ask(do="advise")["advised"] is True
        client.wait(lambda each: each.news and each.news["advice"] is not None)
        advice = client.news["advice"]
        reply = client.ask(do="answer", number=advice["number"], rank=0, answer="accept")
        assert reply["read_back"].endswith(f", {advice['alternatives'][0]['callsign']}")
        client.wait(lambda each: each.news["advice"] is None)


def test_the_approaches_of_all_pairs_are_predicted(session):
    stepped = session.control.cycle + 1
    with session.client() as client:
        client.send(do="step")
        client.wait(lambda each: each.news and each.news["monitor"]["cycle"] == stepped)
        assert client.news["monitor"] == json.loads(json.dumps(session.control.views.monitor()))


@pytest.mark.parametrize(
    "text",
    ["", "nonsense", "{}", '{"do": "fly"}', '{"do": "step", "more": 1}', "[" * 1900],
)
def test_refuses_what_is_not_a_message(session, text):
    cycle = session.control.cycle
    with session.client() as client:
        client.socket.send(text)
        client.wait(lambda each: True)
        assert client.ask(do="trial", text="AC1")["kind"] == "refused"
    assert session.control.cycle == cycle


def test_refusals_name_the_reason(session):
    with session.client() as client:
        refused = client.ask(do="clear", text="AC999 climb 340")
        assert refused["reason"].startswith("unknown callsign 'AC999'")
        refused = client.ask(do="answer", number=99, rank=0, answer="accept")
        assert "allowed: ask again" in refused["reason"]
        refused = client.ask(do="rewind", cycle=99_999)
        assert "allowed: 0 to" in refused["reason"]


def test_a_browser_that_sends_too_much_is_refused_and_holds_up_nobody(session):
    with session.client() as loud, session.client() as calm:
        with pytest.raises(ConnectionClosed):
            flood(loud.socket, 5_000)
        assert calm.ask(do="trial", text="AC999")["kind"] == "refused"
    assert 1 <= len(session.log) <= 20  # a few lines of each browser, however much it sends
    with session.client() as client, pytest.raises(ConnectionClosed):
        flood(client.socket, 1, "x" * 100_000)


def flood(socket, count, text='{"do": "fly"}'):
    """Send a text many times, then receive until the connection is closed."""
    for _ in range(count):
        socket.send(text)
    while True:
        socket.recv(timeout=TIMEOUT_S)


def test_a_browser_that_does_not_read_gets_everything_later(session):
    with session.client() as slow, session.client() as calm:
        begin = session.control.cycle
        for _ in range(15):
            calm.ask(do="trial", text="AC999")
            calm.send(do="step")
        calm.wait(lambda each: each.news and each.news["status"]["cycle"] >= begin + 15)
        slow.wait(lambda each: each.news and each.news["status"]["cycle"] >= begin + 15)
        flown = [each["cycle"] for each in slow.updates if "cycle" in each]
        assert flown == list(range(1, session.control.cycle + 1))


def test_going_back_begins_the_history_again(session):
    with session.client() as client:
        client.wait(lambda each: each.updates)
        client.send(do="rewind", cycle=20)
        client.wait(lambda each: each.news["status"]["cycle"] == 20)
        assert [each["cycle"] for each in client.updates] == list(range(1, 21))


def test_a_port_in_use_is_named():
    with bound_socket(LOOPBACK, 0) as bound:
        bound.listen()
        port = bound.getsockname()[1]
        with pytest.raises(InputError, match=rf"port {port}: .*in use \(allowed: .*free port"):
            bound_socket(LOOPBACK, port)
    with pytest.raises(InputError, match="allowed: an address of this machine"):
        bound_socket("192.0.2.1", 0)
    with pytest.raises(InputError, match=r"allowed: .* a free port"):
        bound_socket(LOOPBACK, 70_000)


def test_an_adviser_that_hangs_is_not_waited_for(monkeypatch):
    monkeypatch.setattr(server, "CLOSING_S", 0.2)
    asked, answers = Event(), Event()

    def hang(conforms):
        asked.set()
        answers.wait()

    with served() as session, session.client() as client:
        monkeypatch.setattr(session.control, "advise", hang)
        client.send(do="advise", conforms=False)
        assert asked.wait(TIMEOUT_S)
    assert session.server.hangs
    answers.set()


def test_an_idle_session_does_not_hang_at_its_end():
    with served() as session:
        pass
    assert not session.server.hangs
