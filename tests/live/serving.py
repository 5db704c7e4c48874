"""A session on a real server, and a client that speaks to it."""

import json
from contextlib import closing, contextmanager
from http.client import HTTPConnection
from typing import Any

from websockets.sync.client import connect

from skystack.live.control import LiveControl
from skystack.live.page import live_page
from skystack.live.server import COOKIE, LiveServer
from skystack.live.serving import LOOPBACK, bound_socket, running

from ..waiting import TIMEOUT_S
from .made import ADVISER, WORLD, opened

TOKEN = "a-token"


class Served:
    """A session that is served."""

    def __init__(self, server: LiveServer, port: int, log: list[str]) -> None:
        self.server, self.port, self.log = server, port, log
        self.control = server.control
        self.link = f"http://{LOOPBACK}:{port}/?token={TOKEN}"

    def get(self, path: str, **headers: str) -> Any:
        """The status, the headers and the body of a page."""
        with closing(HTTPConnection(LOOPBACK, self.port, timeout=TIMEOUT_S)) as connection:
            connection.request("GET", path, headers=headers)
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read().decode()

    @contextmanager
    def client(self, cookie=TOKEN, origin=None, host=None, epoch=-1, known=()):
        """A connected browser, which has some updates of an epoch already."""
        address = f"{LOOPBACK}:{self.port}"
        headers = {"Cookie": f"{COOKIE}={cookie}"}
        if host is not None:
            headers["Host"] = host
        with connect(
            f"ws://{address}/live",
            origin=f"http://{address}" if origin is None else origin,
            additional_headers=headers,
            open_timeout=TIMEOUT_S,
            max_size=None,
        ) as socket:
            yield Client(socket, epoch, known)


class Client:
    """What a page does: send messages, and wait for replies or news."""

    def __init__(self, socket, epoch, known) -> None:
        self.socket = socket
        self.number = 0
        self.updates: list[dict] = list(known)
        self.epoch, self.news = epoch, {}
        self.send(do="follow", epoch=epoch, updates=len(self.updates))

    def send(self, **message) -> int:
        self.number += 1
        self.socket.send(json.dumps({**message, "id": self.number}))
        return self.number

    def receive(self) -> dict:
        """The next message; news is added to what is known."""
        message = json.loads(self.socket.recv(timeout=TIMEOUT_S))
        if message["kind"] == "news":
            if message["epoch"] != self.epoch:
                self.updates = []
            assert message["begin"] == len(self.updates)
            self.epoch, self.news = message["epoch"], message
            self.updates += message["updates"]
        return message

    def ask(self, **message) -> dict:
        """The reply to a message."""
        number = self.send(**message)
        while True:
            found = self.receive()
            if found["kind"] != "news" and found["id"] == number:
                return found

    def wait(self, condition) -> None:
        """Receive until a condition of this client holds."""
        while not condition(self):
            self.receive()


@contextmanager
def served(cycles=600, steps=0):
    """A session on a server, after some cycles."""
    session = opened(seed=3, cycles=cycles)
    control = LiveControl(session, cycles, ADVISER)
    for _ in range(steps):
        control.step()
    log: list[str] = []
    page = live_page(WORLD.sector, "a session")
    server = LiveServer(control, page, TOKEN, log.append)
    with bound_socket(LOOPBACK, 0) as bound:
        application = server.application([LOOPBACK, "localhost"])
        with running(application, bound):
            yield Served(server, bound.getsockname()[1], log)
