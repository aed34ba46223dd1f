"""Links talk to programs that share no code with them: zenoh-ros2-sdk, and a C++ program on Fast DDS.

Both are skipped if they are not installed: `pip install zenoh-ros2-sdk`, `apt install libfastrtps-dev fastddsgen g++`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from drivers.recordings.ros_messages import LASER_SCAN, decode
from drivers.ros2.encoder import GRID, Grid, NodeEncoder
from drivers.ros2.link import LATCHED, SENSOR_DATA
from drivers.ros2.names import NodeNames
from drivers.ros2.selection import Backend, open_link
from drivers.ros2.services import RESET, decode_request, encode_response

from .conftest import Received

CELLS = [0, -1, 100, 100, 0, -1]
MAP = NodeEncoder().grid(1.0, "map", Grid(np.array(CELLS, dtype=np.int8).reshape(2, 3), np.zeros(2), 0.05))
FIRST = 1.25
"""First range of the scans of the peers, metres."""
PATIENCE = 60.0


def answer(request: bytes) -> bytes:
    """Return the request as the result."""
    return encode_response(RESET, {"result": int(decode_request(RESET, request).pause_new_measurements)})


def exchange(backend: Backend, command: list[str], lines: list[str]) -> None:
    """Latch a map, start a peer, and check the lines that it prints and the scans that it sends."""
    with closing(open_link(NodeNames("test"), backend)) as link:
        scans = Received()
        link.subscribe("/scan", LASER_SCAN, SENSOR_DATA, scans)
        link.publish("/map", GRID, LATCHED)(MAP)  # before the peer exists
        if link.serves_services:
            link.serve("/slam_toolbox/reset", RESET, answer)
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as peer:
            assert peer.stdout is not None
            assert [peer.stdout.readline().strip() for _ in lines] == lines
            assert scans.wait(PATIENCE)
            peer.communicate("")
            assert peer.returncode == 0
    scan = decode(scans.messages[0], LASER_SCAN, "cdr")
    assert (scan.header.stamp.sec, scan.header.stamp.nanosec, scan.header.frame_id) == (7, 8, "laser")
    assert scan.ranges.tolist() == [FIRST, 2.0, 3.0]


@pytest.mark.parametrize("backend", [Backend.ZENOH], indirect=True)
def test_zenoh_ros2_sdk_gets_the_map_calls_a_service_and_is_heard(backend: Backend, tmp_path: Path) -> None:
    if find_spec("zenoh_ros2_sdk") is None:
        pytest.skip("zenoh-ros2-sdk is not installed")
    peer = Path(__file__).with_name("zenoh_peer.py")
    exchange(backend, [sys.executable, str(peer), str(tmp_path), str(FIRST)], [f"map {CELLS}", "result 1"])


@pytest.fixture(scope="module")
def fast_dds_peer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Program on Fast DDS, built from the sources beside this file."""
    if not all(map(shutil.which, ("fastddsgen", "g++"))):
        pytest.skip("fastddsgen or g++ is not installed")
    folder = tmp_path_factory.mktemp("peer")
    sources = Path(__file__).with_name("fast_dds_peer")
    idl, program = str(shutil.copy(sources / "messages.idl", folder)), folder / "peer"
    subprocess.run(["fastddsgen", "-replace", "-d", str(folder), idl], cwd=folder, check=True, capture_output=True)
    # As one translation unit, the headers of Fast DDS are compiled once: half of the time.
    generated = [f"-include{folder / name}" for name in ("messages.cxx", "messagesPubSubTypes.cxx")]
    libraries = ["-lfastrtps", "-lfastcdr", "-pthread"]
    command = ["g++", "-std=c++17", f"-I{folder}", *generated, str(sources / "peer.cpp"), *libraries]
    subprocess.run([*command, "-o", str(program)], check=True)
    return program


@pytest.mark.slow  # its program is compiled
@pytest.mark.parametrize("backend", [Backend.DDS], indirect=True)
def test_fast_dds_gets_the_map_and_is_heard(backend: Backend, fast_dds_peer: Path) -> None:
    exchange(backend, [str(fast_dds_peer), os.environ["ROS_DOMAIN_ID"], str(FIRST)], [f"map {CELLS}"])
