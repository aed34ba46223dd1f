"""The links carry messages unchanged between two processes, and late subscribers receive what is latched."""

from __future__ import annotations

import struct
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.recordings.ros_messages import decode
from drivers.ros2.encoder import GRID, Grid, NodeEncoder
from drivers.ros2.link import DEFAULT, LATCHED, SENSOR_DATA
from drivers.ros2.names import NodeNames
from drivers.ros2.selection import Backend, open_link
from drivers.ros2.services import PAUSE, encode_request, encode_response, register_service, service_hash, service_store

from .conftest import Received

ROOT = Path(__file__).parents[3]
PATIENCE = 60.0
PEER = """
import sys, time
from drivers.ros2.link import DEFAULT, LATCHED, SENSOR_DATA
from drivers.ros2.names import NodeNames
from drivers.ros2.selection import Backend, open_link
link = open_link(NodeNames("peer"), Backend(sys.argv[1]))
kind = "nav_msgs/msg/OccupancyGrid"
link.publish("/map", kind, LATCHED)(bytes.fromhex(sys.argv[2]))
link.subscribe("/there", kind, SENSOR_DATA, link.publish("/back", kind, DEFAULT))
print("ready", flush=True)
sys.stdin.read()
link.close()
"""
MAP = NodeEncoder().grid(1.0, "map", Grid(np.arange(6, dtype=np.int8).reshape(2, 3), np.zeros(2), 0.05))


def test_messages_travel_between_processes(backend: Backend) -> None:
    command = [sys.executable, "-c", PEER, backend, MAP.hex()]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as peer:
        assert peer.stdout is not None
        assert peer.stdout.readline() == "ready\n"
        with closing(open_link(NodeNames("test"), backend)) as link:
            latched, back = Received(), Received()
            link.subscribe("/map", GRID, LATCHED, latched)
            assert latched.wait(PATIENCE)
            link.subscribe("/back", GRID, DEFAULT, back)
            put = link.publish("/there", GRID, SENSOR_DATA)
            for _ in range(600):  # until both have found each other
                put(MAP)
                if back.wait(0.1):
                    break
        peer.communicate("")
        assert peer.returncode == 0
    for message in (latched.messages[0], back.messages[0]):
        assert message[4 : len(MAP)] == MAP[4:]
        assert len(message) - len(MAP) < 4  # DDS fills up to four bytes, and says so in the header
        assert decode(message, GRID, "cdr").data.tolist() == list(range(6))


def test_service_answers_over_zenoh(backend: Backend) -> None:
    if backend is not Backend.ZENOH:
        pytest.skip("services are not possible over DDS")
    import zenoh

    attachment = struct.pack("<qqB", 7, 1_000, 16) + bytes(range(16))
    with (
        closing(open_link(NodeNames("test"), backend)) as link,
        closing(open_link(NodeNames("client"), backend)) as client,
    ):
        link.serve("/slam_toolbox/pause", PAUSE, lambda request: encode_response(PAUSE, {"status": len(request) == 5}))
        session: Any = client
        key = f"93/slam_toolbox/pause/slam_toolbox::srv::dds_::Pause_/{service_hash(PAUSE)}"
        for _ in range(600):
            request = encode_request(PAUSE, {})
            replies = session._session.get(key, payload=request, attachment=attachment, target=zenoh.QueryTarget.ALL)
            found = [(reply.ok.payload.to_bytes(), reply.ok.attachment.to_bytes()) for reply in replies if reply.ok]
            if found:
                break
    ((response, accompanying),) = found
    assert service_store().deserialize_cdr(response, f"{PAUSE}_Response").status is True
    assert accompanying[:8] == attachment[:8]
    assert accompanying[16:] == attachment[16:]


def test_hash_of_a_service_is_that_of_ros() -> None:
    """The hash of AddTwoInts is the one in the design document of rmw_zenoh."""
    register_service(service_store(), "example_interfaces/srv/AddTwoInts", "int64 a\nint64 b", "int64 sum")
    expected = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
    assert service_hash("example_interfaces/srv/AddTwoInts") == expected
