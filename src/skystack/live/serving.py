"""Run a live session: its journal, its page and its server, until it is interrupted."""

import secrets
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from skystack.errors import InputError, requires_extra
from skystack.evaluation.scenario_traffic import is_scenario
from skystack.evaluation.traffic import hours_folder
from skystack.evaluation.traffic_conditions import TrafficConditions
from skystack.evaluation.writing import SESSION
from skystack.io.signals import forget, wait_for
from skystack.live.control import LiveControl
from skystack.live.journal import Header, open_journal
from skystack.live.page import live_page
from skystack.live.recorded import LiveSession
from skystack.live.server import COOKIE, LiveServer

with requires_extra("skystack.live.serving", "live"):
    import uvicorn

MOST_FRAME_BYTES = 16_000
"""A browser that sends a larger message is disconnected."""
LOOPBACK = "127.0.0.1"
_LOOPBACK_NAMES = [LOOPBACK, "localhost"]
_ANYWHERE = ("0.0.0.0", "::")
_CLOSING_S = 1
"""The time that browsers have to close their connections at the end."""


class Serving(NamedTuple):
    """Where and how a session is served."""

    out: Path
    listen: str = LOOPBACK
    port: int = 0
    """0 for any free port."""
    fresh: bool = False
    """Whether to begin again instead of continuing a journal."""


def serve(
    opened: LiveSession,
    serving: Serving,
    adviser: str | None,
    announce: Callable[[str], None],
) -> tuple[LiveControl, bool]:
    """Serve a session until SIGINT or SIGTERM; `announce` is called with lines for the user.

    Returns the session as it was left, and whether its thread hangs. Raises InputError if the port
    is in use, or if the journal is damaged or belongs to another session.
    """
    conditions = opened.conditions
    folder = hours_folder(serving.out, SESSION, conditions)
    with (
        bound_socket(serving.listen, serving.port) as bound,
        open_journal(folder, header_of(opened), serving.fresh) as (journal, entries),
    ):
        control = LiveControl(opened, conditions.cycles, adviser, journal, serving.out)
        announce("compiling ...")
        control.compile()
        if entries:
            announce(f"continuing the session in {folder} (--new begins another one)")
            control.restore(entries)
        token = secrets.token_urlsafe(24)
        title = _title(conditions)
        page = live_page(opened.hour.world.sector, title)
        port = bound.getsockname()[1]
        names = ["*"] if serving.listen in _ANYWHERE else [serving.listen, *_LOOPBACK_NAMES]
        server = LiveServer(control, page, token, announce, f"{COOKIE}-{port}")
        application = server.application(names)
        name = LOOPBACK if serving.listen in _ANYWHERE else serving.listen
        name = f"[{name}]" if ":" in name else name
        announce(f"open http://{name}:{port}/?token={token}")
        announce("Ctrl-C ends the session and keeps the recording")
        with running(application, bound) as ended:
            try:
                wait_for(ended)
            except KeyboardInterrupt:
                forget()
    return control, server.hangs


def _title(conditions: TrafficConditions) -> str:
    if conditions.is_the_same_for_every_seed:
        return conditions.recorded_traffic
    traffic = "" if is_scenario(conditions.traffic) else "traffic "
    return f"{traffic}{conditions.recorded_traffic}, seed {conditions.seed}"


@contextmanager
def running(application: Any, bound: socket.socket) -> Iterator["Future[None]"]:
    """Run a server on a socket, in a thread: there it does not handle signals itself.

    Yields a future that is done if the server ends by itself.
    """
    config = uvicorn.Config(
        application,
        log_level="critical",
        access_log=False,
        ws_max_size=MOST_FRAME_BYTES,
        timeout_graceful_shutdown=_CLOSING_S,
    )
    server = uvicorn.Server(config)
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="server") as threads:
        try:
            yield threads.submit(server.run, sockets=[bound])
        finally:
            server.should_exit = True


def header_of(opened: LiveSession) -> Header:
    """The header of the journal of a session."""
    start = [np.asarray(each) for each in opened.hour.start.traffic if each is not None]
    sector = msgspec.json.encode(opened.hour.world.sector)
    return Header(
        traffic=opened.conditions.recorded_traffic,
        seed=opened.conditions.seed,
        sector=sha256(sector).hexdigest(),
        start=sha256(b"".join(each.tobytes() for each in start)).hexdigest(),
        performance=opened.controlled.performance,
        platform=opened.conditions.platform,
    )


def bound_socket(listen: str, port: int) -> socket.socket:
    """A socket that is bound. Raises InputError if that is not possible."""
    family: Any = socket.AF_INET6 if ":" in listen else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((listen, port))
        bound.listen()  # browsers that come before the server is up wait for it
    except (OSError, OverflowError) as error:
        bound.close()
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"{listen} port {port}: {reason} (allowed: an address of this machine and a free port)"
        ) from None
    return bound
