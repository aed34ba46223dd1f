"""Requests to the live page: the page itself, and the connection of each open page.

Each page receives one frame at a time, and the next one when it has drawn that. So nothing is queued for slow or hidden
pages, and what they show is new.
"""

from __future__ import annotations

import asyncio
import json
import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tornado.web import HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

if TYPE_CHECKING:
    from .server import PageServer

MAX_CLIENTS = 8
MIN_PERIOD = 0.01
"""Seconds between two frames: displays show at most about a hundred per second."""
MAX_COMMAND_DELAY = 0.3
"""Seconds by which a drive command may be later than the fastest one of the same page: commands that a network has held
back must not move the robot.
"""
MAX_CLOCK_DRIFT = 1e-3
"""Relative rate by which the clocks of both computers may differ."""
HOST_PATTERN = re.compile(r"[A-Za-z0-9.:\[\]-]+")
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


@dataclass(slots=True)
class PageActions:
    """What the page can do; None: it has no such button. The functions are called in the thread of the server.

    save   saves the map
    pause  drops scans, or uses them again
    freeze  only localises in the map, or extends it again
    drive  drives at a speed (m/s) and a turn rate (rad/s)
    limits  highest speed and turn rate
    """

    save: Callable[[], None] | None = None
    pause: Callable[[bool], None] | None = None
    freeze: Callable[[bool], None] | None = None
    drive: Callable[[float, float], None] | None = None
    limits: tuple[float, float] = (0.0, 0.0)


class PageHandler(RequestHandler):
    """Handler of the page itself."""

    def initialize(self, server: PageServer, page: tuple[str, str]) -> None:
        """Set the page and its Content-Security-Policy."""
        self._server, self._page = server, page

    def prepare(self) -> None:
        """Refuse requests that are not allowed."""
        _check(self, self._server)

    def set_default_headers(self) -> None:
        """Set the headers of all responses."""
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def get(self) -> None:
        """Send the page."""
        text, policy = self._page
        host = self.request.host
        if HOST_PATTERN.fullmatch(host):  # some browsers do not take WebSockets for connections to 'self'
            policy = policy.replace("connect-src 'self'", f"connect-src 'self' ws://{host}")
        self.set_header("Content-Security-Policy", policy)
        self.finish(text)

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Send the reason of an error as text."""
        self.set_header("Content-Type", "text/plain")
        self.finish(f"{status_code} {self._reason}\n")


class Client(WebSocketHandler):
    """Connection of one page.

    changed  set when the state has changed
    """

    def initialize(self, server: PageServer) -> None:
        """Begin with nothing seen."""
        self._server = server
        self.changed, self._drawn = asyncio.Event(), asyncio.Event()
        self._seen: dict[str, int] = {}
        self._sender: asyncio.Task[None] | None = None
        self._fastest = math.inf  # smallest difference between this computer's clock and the page's, seconds
        self._commanded_at = time.monotonic()
        self._drives = False

    def prepare(self) -> None:
        """Refuse requests that are not allowed, and clients beyond MAX_CLIENTS."""
        _check(self, self._server)
        if self.request.headers.get("Origin") is None:
            raise HTTPError(403, reason="no Origin")
        if len(self._server.clients) >= MAX_CLIENTS:
            raise HTTPError(503, reason="too many pages are open")

    def check_origin(self, origin: str) -> bool:
        """Return True for pages of this server."""
        return origin == f"http://{self.request.host}"

    def write_error(self, status_code: int, **kwargs: Any) -> None:
        """Send the reason of an error as text."""
        self.set_header("Content-Type", "text/plain")
        self.finish(f"{status_code} {self._reason}\n")

    async def open(self, *_: str, **__: str) -> None:
        """Begin to send."""
        self.set_nodelay(True)
        self._server.clients.add(self)
        self._sender = asyncio.create_task(self._send())

    def on_close(self) -> None:
        """Stop sending, and the robot if this page drove it."""
        self._server.clients.discard(self)
        if self._sender is not None:
            self._sender.cancel()
        self._stop_driving()

    def on_message(self, message: str | bytes) -> None:
        """Process a message of the page; wrong ones are ignored."""
        try:
            content = json.loads(message)
        except ValueError:
            return
        if not isinstance(content, dict):
            return
        actions = self._server.actions
        if content.get("drawn"):
            self._drawn.set()
        if content.get("save") is True and actions.save is not None:
            actions.save()
        if isinstance(content.get("pause"), bool) and actions.pause is not None:
            actions.pause(content["pause"])
        if isinstance(content.get("freeze"), bool) and actions.freeze is not None:
            actions.freeze(content["freeze"])
        if "drive" in content and actions.drive is not None:
            self._drive(content["drive"], content.get("time"))

    async def _send(self) -> None:
        self.changed.set()
        try:
            while True:
                await self.changed.wait()
                self.changed.clear()
                frame = self._server.state.frame(self._seen)
                if frame is None:
                    continue
                self._drawn.clear()
                await self.write_message(frame)
                await self._drawn.wait()
                await asyncio.sleep(MIN_PERIOD)
        except WebSocketClosedError:
            return

    def _drive(self, command: Any, sent: Any) -> None:
        """Drive at shares of the limits, [forwards, counter-clockwise] from -1 to 1, unless the command is late.

        sent  time on the page's clock, milliseconds
        """
        numbers = [*command, sent] if isinstance(command, list) and len(command) == 2 else []
        if not numbers or not all(isinstance(value, int | float) and math.isfinite(value) for value in numbers):
            return
        forwards, left = (min(max(value, -1.0), 1.0) for value in numbers[:2])
        now = time.monotonic()
        delay = now - sent / 1000
        self._fastest = min(self._fastest + MAX_CLOCK_DRIFT * (now - self._commanded_at), delay)
        self._commanded_at = now
        if delay > self._fastest + MAX_COMMAND_DELAY and (forwards, left) != (0.0, 0.0):
            return
        self._drives = (forwards, left) != (0.0, 0.0)
        self._give_command(forwards, left)

    def _stop_driving(self) -> None:
        if self._drives:
            self._drives = False
            self._give_command(0.0, 0.0)

    def _give_command(self, forwards: float, left: float) -> None:
        actions = self._server.actions
        if actions.drive is not None:
            actions.drive(forwards * actions.limits[0], left * actions.limits[1])


def _check(handler: RequestHandler, server: PageServer) -> None:
    """Raise HTTPError 403 if a request is not allowed."""
    if not server.is_allowed(handler.request.host or "", handler.get_query_argument("token", "")):
        raise HTTPError(403, reason="the URL lacks the token, or names another computer")
