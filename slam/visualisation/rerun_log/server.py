"""Where viewers can look on while the log is written.

Viewers come to the log, not the log to a viewer: a log that is sent to a viewer which is not there yet, or which goes
and comes again, never arrives.
"""

from __future__ import annotations

import socket
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from ...errors import OutputError

LOCAL, EVERYWHERE = "127.0.0.1", "0.0.0.0"
PORT = 9877
"""Not 9876, which is the viewers' own: a viewer that finds somebody there takes it for another viewer, and sends what
it was to show.
"""


class ViewerServer:
    """An address of this computer (IPv4) and a port at which viewers may connect; a context.

    The port is held from the beginning, so that what is wrong with it shows before anything else is begun, and no
    other program takes it; `release` gives it to the log. Raises OutputError where the port is taken or this computer
    has no such address.

    address  of this computer
    port     None asks for the `usual` one, or where that is taken for any
    """

    def __init__(self, address: str = LOCAL, port: int | None = None, *, usual: int = PORT) -> None:
        self._held = _first_free(address, (usual, 0) if port is None else (port,))
        self.address: str = self._held.getsockname()[0]
        self.port: int = self._held.getsockname()[1]

    @property
    def url(self) -> str:
        """What a viewer is told: `rerun --connect URL`."""
        return f"rerun+http://{self.host}:{self.port}/proxy"

    @property
    def host(self) -> str:
        """By what name those who may connect reach this computer."""
        return socket.gethostname() if self.address == EVERYWHERE else self.address

    def answers(self) -> bool:
        """Whether somebody has taken the port over and accepts connections."""
        try:
            socket.create_connection((LOCAL if self.address == EVERYWHERE else self.address, self.port), 1.0).close()
        except OSError:
            return False
        return True

    def release(self) -> None:
        """Let the port go; further calls do nothing."""
        self._held.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


def _first_free(address: str, ports: Sequence[int]) -> socket.socket:
    failures: list[OSError] = []
    for port in ports:
        try:
            return socket.create_server((address, port))
        except OSError as error:
            failures.append(error)
    reason = failures[-1].strerror or failures[-1]
    raise OutputError(f"{address}: viewers cannot be served at port {ports[-1]}: {reason}")
