"""Port of this computer on which viewers or browsers are served."""

from __future__ import annotations

import socket
from collections.abc import Sequence

from ..errors import OutputError


def bind_first_free(address: str, ports: Sequence[int], served: str) -> socket.socket:
    """Return a listening socket on the first of some ports that is free; port 0 is any free one.

    address  of this computer, IPv4 or IPv6, or its name
    served   what is served there, for the error text, e.g. "viewers"

    Raises OutputError if all ports are taken, or this computer does not have the address.
    """
    failures: list[OSError] = []
    for port in ports:
        try:
            family = socket.AF_INET6 if ":" in address else socket.AF_INET
            return socket.create_server((address, port), family=family)
        except OSError as error:
            failures.append(error)
    reason = (failures[0].strerror or str(failures[0])).partition(" (while attempting")[0]  # create_server adds that
    raise OutputError(f"{address}: {served} cannot be served at port {ports[0]}: {reason}")
