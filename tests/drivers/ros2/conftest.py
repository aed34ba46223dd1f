"""Links to ROS 2 on the loopback interface, and what arrives on them."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from importlib.util import find_spec

import pytest

from drivers.ros2.selection import PACKAGES, Backend

LOOPBACK = """<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""


@pytest.fixture(params=[Backend.ZENOH, Backend.DDS])
def backend(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Backend]:
    """A kind of link on the loopback interface, in a domain of its own."""
    kind: Backend = request.param
    if find_spec(PACKAGES[kind]) is None:
        pytest.skip(f"{PACKAGES[kind]} is not installed")
    monkeypatch.setenv("ROS_DOMAIN_ID", "93")
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    if kind is Backend.DDS:
        yield kind
        return
    import zenoh

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = json.dumps([f"tcp/127.0.0.1:{free.getsockname()[1]}"])
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", f'connect/endpoints={address};listen/endpoints=["tcp/127.0.0.1:0"]')
    router = f'{{mode: "router", listen: {{endpoints: {address}}}, scouting: {{multicast: {{enabled: false}}}}}}'
    with zenoh.open(zenoh.Config.from_json5(router)):
        yield kind


class Received:
    """Receiver of messages."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []
        self._changed = threading.Condition()

    def __call__(self, data: bytes) -> None:
        with self._changed:
            self.messages.append(data)
            self._changed.notify_all()

    def wait(self, timeout: float) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: bool(self.messages), timeout)
