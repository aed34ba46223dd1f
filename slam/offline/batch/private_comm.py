"""Connections between the processes of one batch, which no other user of the computer can join.

Workers execute any code that is sent to them. Dask's plain TCP admits every local program, and its TLS needs another
library. Here every connection begins with a secret of the batch; without it, nothing else is read.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
from typing import Any

import dask
from distributed.comm import registry
from distributed.comm.tcp import TCPBackend, TCPConnector, TCPListener
from tornado.iostream import StreamClosedError

PROTOCOL = "wclm"
"""Protocol of the addresses."""
SECRET_KEY = "wclm.secret"
"""Key of Dask's configuration with the secret; the configuration is passed to workers through a pipe."""
SECRET_SIZE = 32
"""Bytes."""
SECRET_TIMEOUT = 10.0
"""Seconds until a connection without the secret is closed."""


def new_secret() -> str:
    """Return a random secret."""
    return secrets.token_hex(SECRET_SIZE)


def register_protocol() -> None:
    """Make PROTOCOL known to Dask in this process."""
    registry.backends[PROTOCOL] = _Backend()


def _secret() -> bytes:
    return bytes.fromhex(dask.config.get(SECRET_KEY))


class _Connector(TCPConnector):
    prefix = f"{PROTOCOL}://"

    async def connect(self, address: str, deserialize: bool = True, **connection_args: Any) -> Any:
        comm = await super().connect(address, deserialize, **connection_args)  # type: ignore[no-untyped-call]
        await comm.stream.write(_secret())
        return comm


class _Listener(TCPListener):
    prefix = f"{PROTOCOL}://"

    async def _prepare_stream(self, stream: Any, address: str) -> Any:
        """Return the stream if it begins with the secret, else close it and return None."""
        try:
            received = await asyncio.wait_for(stream.read_bytes(SECRET_SIZE), SECRET_TIMEOUT)
        except (StreamClosedError, TimeoutError):
            received = b""
        if hmac.compare_digest(received, _secret()):
            return stream
        stream.close()
        return None


class _Backend(TCPBackend):
    _connector_class = _Connector
    _listener_class = _Listener
