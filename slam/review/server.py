"""Where viewers can look on while the log is written.

Viewers come to the log, not the log to a viewer: a log that is sent to a viewer which is not there yet, or which goes
and comes again, never arrives.
"""

from __future__ import annotations

import socket
from dataclasses import dataclass

from ..errors import OutputError

LOCAL, EVERYWHERE = "127.0.0.1", "0.0.0.0"
PORT = 9877
"""Not 9876, which is the viewers' own: a viewer that finds somebody there takes it for another viewer, and sends what
it was to show.
"""


@dataclass(frozen=True, slots=True)
class ViewerServer:
    """An address of this computer (IPv4) and a port at which viewers may connect."""

    address: str
    port: int

    @property
    def url(self) -> str:
        """What a viewer is told: `rerun --connect URL`."""
        host = socket.gethostname() if self.address == EVERYWHERE else self.address
        return f"rerun+http://{host}:{self.port}/proxy"

    @classmethod
    def at(cls, address: str = LOCAL, port: int | None = None) -> ViewerServer:
        """At a port; None is PORT, or where that is taken any.

        Raises OutputError where the port is taken or this computer has no such address.
        """
        for candidate in (PORT, 0) if port is None else (port,):
            try:
                with socket.create_server((address, candidate)) as probe:
                    return cls(*probe.getsockname())
            except OSError as error:
                failure = error
        raise OutputError(f"{address}: viewers cannot be served at port {candidate}: {failure.strerror or failure}")
