"""Web server of the live page, in a thread of its own.

The page only works on the computer itself unless another address is requested. Then every request must contain a random
token. Requests by pages of other origins are refused in any case.
"""

from __future__ import annotations

import asyncio
import hmac
import logging
import secrets
import socket
import threading
from base64 import b64encode
from hashlib import sha256
from importlib.resources import files
from ipaddress import ip_address
from string import Template
from types import TracebackType
from typing import Self
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.web import Application, url

from ..server_socket import bind_first_free
from .live_state import LiveState
from .requests import Client, PageActions, PageHandler

PORT = 8090
"""Default; if it is taken, any free port."""
LOCALHOST, ALL_INTERFACES = "127.0.0.1", ("0.0.0.0", "::")
MAX_MESSAGE_SIZE = 1024
"""Bytes of a message from a page."""
LAST_FRAME_DURATION = 0.3
"""Seconds that clients have to fetch the last state of the run."""
PING_PERIOD = 5.0
"""Seconds; a client that does not answer is disconnected."""


class PageServer:
    """Server of the page; a context manager. The port is bound at construction.

    state    what the page shows
    actions  what it can do; may be set until the server is entered
    address  of this computer; if others can reach it, the URL contains a token
    port     None selects PORT, or a free one if that is taken

    Raises OutputError if the port is taken or this computer does not have the address.
    """

    def __init__(self, state: LiveState, address: str = LOCALHOST, port: int | None = None) -> None:
        self.state, self.actions = state, PageActions()
        self._socket = bind_first_free(address, (PORT, 0) if port is None else (port,), "the page")
        self._socket.setblocking(False)
        self.address: str = self._socket.getsockname()[0]
        self.port: int = self._socket.getsockname()[1]
        self.token = "" if ip_address(self.address).is_loopback else secrets.token_urlsafe(16)
        self.clients: set[Client] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="page", daemon=True)
        self._is_waking = False

    @property
    def url(self) -> str:
        """URL of the page, with the token if one is required."""
        host = socket.gethostname() if self.address in ALL_INTERFACES else self.address
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    def __enter__(self) -> Self:
        _silence_log()
        self._thread.start()
        asyncio.run_coroutine_threadsafe(self._listen(), self._loop).result()
        self.state.changed = self._wake
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.state.changed = lambda: None
        asyncio.run_coroutine_threadsafe(self._close(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def is_allowed(self, host: str, token: str) -> bool:
        """Return True if a request with this Host header and token may be answered.

        Without a token only names of this computer itself are allowed: a page of another site can make its own name
        point to this computer, but not change the header.
        """
        if self.token:
            return hmac.compare_digest(token.encode(), self.token.encode())
        name = urlsplit(f"//{host}").hostname or ""
        return name in ("localhost", self.address)

    async def _listen(self) -> None:
        page = _page()
        routes = [
            url(r"/", PageHandler, {"server": self, "page": page}),
            url(r"/live", Client, {"server": self}),
        ]
        application = Application(
            routes,
            log_function=lambda handler: None,
            websocket_ping_interval=PING_PERIOD,
            websocket_max_message_size=MAX_MESSAGE_SIZE,
        )
        self._http = HTTPServer(application, idle_connection_timeout=60.0, max_body_size=MAX_MESSAGE_SIZE)
        self._http.add_sockets([self._socket])

    async def _close(self) -> None:
        """Give all clients time to fetch the last state, and close their connections."""
        self._http.stop()
        self._wake_clients()
        if self.clients:
            await asyncio.sleep(LAST_FRAME_DURATION)
        for client in list(self.clients):
            client.close(1001, "the run is over")
        await self._http.close_all_connections()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    def _wake(self) -> None:
        """Wake all clients; called from any thread."""
        if self.clients and not self._is_waking:
            self._is_waking = True
            self._loop.call_soon_threadsafe(self._wake_clients)

    def _wake_clients(self) -> None:
        self._is_waking = False
        for client in self.clients:
            client.changed.set()


def _page() -> tuple[str, str]:
    """Return the page as one text, and its Content-Security-Policy."""
    parts = {name: files(__package__).joinpath(f"page.{name}").read_text("utf-8") for name in ("html", "css", "js")}
    style, script = (b64encode(sha256(parts[name].encode()).digest()).decode() for name in ("css", "js"))
    policy = (
        f"default-src 'none'; style-src 'sha256-{style}'; script-src 'sha256-{script}'; img-src data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return Template(parts["html"]).substitute(style=parts["css"], script=parts["js"]), policy


def _silence_log() -> None:
    """Keep refused requests and damaged data of clients out of the terminal of the run."""
    log = logging.getLogger("tornado")
    log.addHandler(logging.NullHandler())
    log.propagate = False
