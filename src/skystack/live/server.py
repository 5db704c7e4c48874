"""The server of a live session: one page, and a websocket for each browser that shows it.

Whoever has the token in the printed link controls the session. The token becomes a cookie that
browsers do not send from other sites. Websockets from another origin are refused as well: another
port of this host is the same site.

One thread makes all calls that change the session or compute from it, in turn. A browser receives
the updates that it does not have yet, in one message; a slow one receives larger messages later and
never holds up the simulation.
"""

import asyncio
import hmac
import json
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, suppress
from typing import Any

from skystack.errors import InputError, printable, requires_extra
from skystack.live.control import LiveControl
from skystack.live.messages import (
    Advise,
    AnswerAdvice,
    Choices,
    Clear,
    Follow,
    HandOver,
    Message,
    Play,
    Rewind,
    Speed,
    StepOnce,
    TryClearance,
    read_message,
)
from skystack.simulator.simulator import CYCLE_S

with requires_extra("skystack.live.server", "live"):
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.middleware.trustedhost import TrustedHostMiddleware
    from starlette.requests import HTTPConnection, Request
    from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
    from starlette.routing import Route, WebSocketRoute
    from starlette.websockets import WebSocket, WebSocketDisconnect

MESSAGES_PER_S, BURST = 20.0, 100.0
"""How many messages a browser may send: on average, and at once."""
MOST_BROWSERS = 20
CLOSING_S = 10.0
"""How long a call that runs when the server ends is waited for."""
MONITOR_EVERY_S = 1.0
"""The minimum time between two predictions of all pairs."""
MOST_REFUSALS = 1000
"""A browser with more refused messages is disconnected."""
POLICY_VIOLATION = 1008
COOKIE = "skystack-session"
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class LiveServer:
    """Serves one session. All calls of the session run in one thread, in turn."""

    def __init__(
        self,
        control: LiveControl,
        page: str,
        token: str,
        log: Callable[[str], None],
        cookie: str = COOKIE,
    ) -> None:
        """`log` is called with a line for every refused message, up to a limit.

        Servers on different ports of a host need different names of the cookie.
        """
        self.control, self._page, self._token, self.log = control, page, token, log
        self._cookie = cookie
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="session")
        self._changed = asyncio.Condition()
        self._number = 0
        """Increased with every change."""
        self._browsers = 0
        self._monitor: dict[str, Any] = {"cycle": 0, "pairs": []}
        self._problem: str | None = None
        self.hangs = False
        """Whether the thread of the session did not come to an end with the server."""

    def application(self, hosts: list[str]) -> Starlette:
        """The application. Requests to other host names than `hosts` are refused."""
        return Starlette(
            routes=[Route("/", self._get), WebSocketRoute("/live", self._serve)],
            middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=hosts, www_redirect=False)],
            lifespan=self._lifespan,
        )

    @asynccontextmanager
    async def _lifespan(self, _: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(work()) for work in (self._run, self._predict)]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            # A cycle that is being flown is completed; an adviser that hangs is not waited for.
            try:
                await asyncio.wait_for(self.call(lambda: None), CLOSING_S)
            except TimeoutError:
                self.hangs = True
            self._executor.shutdown(wait=False, cancel_futures=True)

    async def _get(self, request: Request) -> Response:
        given = request.query_params.get("token")
        if given is not None and self._is_token(given):
            # The address bar then shows no token, and reloading the page still works.
            response: Response = RedirectResponse("/", status_code=303, headers=HEADERS)
            response.set_cookie(self._cookie, self._token, httponly=True, samesite="strict")
            return response
        if not self._is_known(request):
            return PlainTextResponse(
                "Open the link that `skystack session` printed.\n", 403, headers=HEADERS
            )
        return HTMLResponse(self._page, headers=HEADERS)

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(errors="replace"), self._token.encode())

    def _is_known(self, connection: HTTPConnection) -> bool:
        return self._is_token(connection.cookies.get(self._cookie, ""))

    async def _serve(self, socket: WebSocket) -> None:
        """One browser, from the handshake to the end of its connection."""
        host, origin = socket.headers.get("host"), socket.headers.get("origin")
        is_ours = self._is_known(socket) and origin == f"http://{host}"
        if not is_ours or self._browsers >= MOST_BROWSERS:
            await socket.close(POLICY_VIOLATION)
            return
        await socket.accept()
        self._browsers += 1
        try:
            await _Browser(self, socket).serve()
        finally:
            self._browsers -= 1

    async def call(self, function: Callable[[], Any]) -> Any:
        """Call a function of the session in its thread."""
        return await asyncio.get_running_loop().run_in_executor(self._executor, function)

    async def change(self, function: Callable[[], Any]) -> Any:
        """Call a function that changes the session, and tell all browsers."""
        try:
            return await self.call(function)
        finally:
            await self.notify()

    async def notify(self) -> None:
        """Wake the browsers: something has changed."""
        async with self._changed:
            self._number += 1
            self._changed.notify_all()

    async def changes(self, known: int) -> int:
        """Wait until there has been a change after change `known`; returns its number."""
        async with self._changed:
            await self._changed.wait_for(lambda: self._number > known)
            return self._number

    def news(self, epoch: int, updates: int) -> dict[str, Any]:
        """What a browser does not have yet. Called in the thread of the session."""
        control, history = self.control, self.control.history
        begin = updates if epoch == history.epoch else 0
        return {
            "kind": "news",
            "epoch": history.epoch,
            "begin": begin,
            "updates": history.updates[begin:],
            "status": control.status(),
            "advice": None if control.advice is None else control.shown,
            "monitor": self._monitor,
            "problem": self._problem,
        }

    async def _run(self) -> None:
        """Fly cycles at the chosen speed.

        If the machine is too slow, the session falls behind; it does not skip cycles.
        """
        flown_at = time.monotonic()
        while True:
            known = self._number
            if not self.control.playing:
                await self.changes(known)
                flown_at = time.monotonic()
                continue
            interval_s = CYCLE_S / self.control.speed
            wait_s = flown_at + interval_s - time.monotonic()
            if wait_s > 0.0:
                with suppress(TimeoutError):  # a change of the speed takes effect at once
                    await asyncio.wait_for(self.changes(known), wait_s)
                continue
            flown_at = max(flown_at, time.monotonic() - 2.0 * interval_s) + interval_s
            await self.change(self._step)

    def _step(self) -> None:
        if not self.control.playing:  # paused in the meantime
            return
        try:
            self.control.step()
            self._problem = None
        except Exception as error:  # the adviser may be anybody's code
            self.control.playing = False
            self._problem = f"Paused: {_in_one_line(error)}"
            self.log(self._problem)

    async def _predict(self) -> None:
        """Predict the approaches of all pairs whenever there is time and something has changed."""
        known = -1
        while True:
            known = await self.changes(known)
            monitor = await self.call(self.control.views.monitor)
            if monitor != self._monitor:
                self._monitor = monitor
                known += 1  # the change that this makes
                await self.notify()
            await asyncio.sleep(MONITOR_EVERY_S)


class _Browser:
    """The connection of one browser."""

    def __init__(self, server: LiveServer, socket: WebSocket) -> None:
        self._server, self._socket = server, socket
        self._epoch, self._updates = -1, 0
        self._may_send, self._last = BURST, time.monotonic()
        self._refusals = 0
        self._following = asyncio.Event()
        """Set once the page has sent `follow`."""
        self._sending = asyncio.Lock()

    async def serve(self) -> None:
        news = asyncio.create_task(self._send_news())
        try:
            while True:
                received = await self._socket.receive()
                if received["type"] == "websocket.disconnect":
                    return
                await self._receive(received.get("text") or received.get("bytes") or "")
                if self._refusals > MOST_REFUSALS:
                    await self._socket.close(POLICY_VIOLATION)
                    return
        finally:
            news.cancel()
            with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError, OSError):
                await news

    async def _send_news(self) -> None:
        await self._following.wait()
        known = -1
        while True:
            known = await self._server.changes(known)
            await self._send_all()

    async def _send_all(self) -> None:
        server = self._server
        news = await server.call(lambda: server.news(self._epoch, self._updates))
        self._epoch, self._updates = news["epoch"], news["begin"] + len(news["updates"])
        await self._send(news)

    async def _send(self, value: dict[str, Any]) -> None:
        async with self._sending:
            await self._socket.send_text(json.dumps(value, separators=(",", ":")))

    async def _receive(self, text: str | bytes) -> None:
        is_allowed = self._is_allowed()
        try:
            message = read_message(text)
        except InputError as error:
            await self._refuse(str(error), 0)
            return
        if not is_allowed:
            await self._refuse("too many messages", message.id)
            return
        try:
            reply = await self._do(message)
        except Exception as error:  # of the adviser: see `_step`
            reason = _in_one_line(error)
            await self._send({"kind": "refused", "id": message.id, "reason": reason})
            return
        if reply is not None:
            await self._send({"kind": "reply", "id": message.id} | reply)

    def _is_allowed(self) -> bool:
        """Whether one more message is within the limits; counts it if it is."""
        now = time.monotonic()
        self._may_send = min(BURST, self._may_send + MESSAGES_PER_S * (now - self._last))
        self._last = now
        if self._may_send < 1.0:
            return False
        self._may_send -= 1.0
        return True

    async def _refuse(self, reason: str, number: int) -> None:
        self._refusals += 1
        is_logged = self._refusals <= 3  # more would only fill the log
        if is_logged:
            self._server.log(f"refused: {reason}")
        if is_logged or number:  # the page waits for a reply
            await self._send({"kind": "refused", "id": number, "reason": reason})

    async def _do(self, message: Message) -> dict[str, Any] | None:
        """Do what a message says; returns a reply to this browser, or None."""
        server, control = self._server, self._server.control
        reply: dict[str, Any] | None = None
        match message:
            case Follow(epoch=epoch, updates=updates):
                if not self._following.is_set():
                    self._epoch = epoch
                    self._updates = min(updates, len(control.history.updates))
                    self._following.set()
            case TryClearance(text=text):
                reply = {"trial": await server.call(lambda: control.trial(text))}
            case Choices(callsign=callsign):
                reply = await server.call(lambda: control.choices(callsign))
            case Advise(conforms=conforms):
                shown = await server.change(lambda: self._advise(conforms))
                reply = {"advised": shown}
            case AnswerAdvice(number=number, rank=rank, answer="refuse"):
                await server.call(lambda: control.refuse(number, rank))
                reply = {"refused": rank}
            case AnswerAdvice(number=number, rank=rank):
                reply = {"read_back": await server.change(lambda: control.accept(number, rank))}
            case Clear(text=text, modifies=modifies):
                reply = {"read_back": await server.change(lambda: control.clear(text, modifies))}
            case Play(on=False):  # also while an adviser keeps the thread busy
                control.playing = False
                await server.notify()
            case _:
                await server.change(lambda: _set(control, message))
                reply = {} if message.id else None
        return reply

    def _advise(self, conforms: bool) -> bool:
        return self._server.control.advise(conforms) is not None


def _in_one_line(error: Exception) -> str:
    words = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
    return printable(words)


def _set(control: LiveControl, message: Message) -> None:
    """Handle a message that only needs an acknowledgement."""
    match message:
        case Play(on=on):
            control.playing = on and not control.ended
        case Speed(times=times):
            control.speed = times
        case StepOnce():
            control.playing = False
            control.step()
        case HandOver(callsigns=callsigns, to_adviser=to_adviser):
            control.hand_over(callsigns, to_adviser)
        case Rewind(cycle=cycle):
            control.rewind(cycle)
