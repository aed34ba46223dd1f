"""Find the Rerun viewer's program, and serve a log to viewers while it is written.

Viewers connect to the log, not the log to a viewer: rows sent to a viewer that is not running yet, or that is
restarted, would be lost.
"""

from __future__ import annotations

import socket
from pathlib import Path
from types import TracebackType
from typing import Self

from ..server_socket import bind_first_free

LOCALHOST, ALL_INTERFACES = "127.0.0.1", "0.0.0.0"
PORT = 9877
"""Not 9876, the default of viewers: a viewer takes a server at that port for another viewer, and sends it the log that
it was started with.
"""


def viewer_executable() -> str:
    """Return the path of the viewer's binary.

    The `rerun` command on the path is a script that starts the binary and leaves it running when the script is killed.
    """
    import rerun_cli

    name = Path(rerun_cli.__file__).with_name("rerun")
    return str(name if name.exists() else name.with_suffix(".exe"))


class ViewerServer:
    """An IPv4 address of this computer and a port to which viewers can connect; a context manager.

    The port is bound at construction, so that an unusable port is reported before anything else starts and no other
    program takes it; `release` frees it for the log. Raises OutputError if the port is taken or this computer does not
    have the address.

    address  of this computer
    port     None selects the `default` port, or any free one if that is taken
    """

    def __init__(self, address: str = LOCALHOST, port: int | None = None, *, default: int = PORT) -> None:
        self._socket = bind_first_free(address, (default, 0) if port is None else (port,), "viewers")
        self.address: str = self._socket.getsockname()[0]
        self.port: int = self._socket.getsockname()[1]

    @property
    def url(self) -> str:
        """URL for `rerun --connect URL`."""
        return f"rerun+http://{self.host}:{self.port}/proxy"

    @property
    def host(self) -> str:
        """Host name or address at which other programs reach this server."""
        return socket.gethostname() if self.address == ALL_INTERFACES else self.address

    def accepts_connections(self) -> bool:
        """Return True if a program listens at the port."""
        host = LOCALHOST if self.address == ALL_INTERFACES else self.address
        try:
            socket.create_connection((host, self.port), 1.0).close()
        except OSError:
            return False
        return True

    def release(self) -> None:
        """Free the port; further calls do nothing."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()
