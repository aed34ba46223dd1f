"""The driver reads a lidar that is emulated on a pseudo terminal: `pip install . && pytest`."""

import os
import pty
import threading
import time
import tty
from collections.abc import Iterator

import numpy as np
import pytest
from wclm_xv11 import FIRST_INDEX, LAYOUT, PACKETS, SPEED_UNIT, START, TURN_DURATION, Xv11Decoder, checksums

import drivers
from drivers import Scan

RANGE = 2.5  # metres, in all directions but one


def turn() -> bytes:
    """Return the packets of one turn in a round room; the beam at 90 degrees has no return."""
    packets = np.zeros(PACKETS, LAYOUT)
    packets["start"], packets["index"] = START, FIRST_INDEX + np.arange(PACKETS)
    packets["speed"] = round(60.0 / TURN_DURATION * SPEED_UNIT)
    packets["readings"]["range"], packets["readings"]["strength"] = round(1e3 * RANGE), 200
    packets["readings"]["range"][22, 2] |= 0x8000
    packets["checksum"] = checksums(packets.view(np.uint8).reshape(PACKETS, -1))
    return packets.tobytes()


@pytest.fixture
def port() -> Iterator[str]:
    """Path of a serial port at which the lidar sends, in bursts as a USB adapter does."""
    controller, other = pty.openpty()
    tty.setraw(other)
    ended = threading.Event()

    def send() -> None:
        stream, size, begin, sent = turn(), LAYOUT.itemsize, time.monotonic(), 0
        while not ended.wait(0.005):
            due = int((time.monotonic() - begin) / TURN_DURATION * PACKETS)
            for k in range(sent, due):
                first = k % PACKETS * size
                os.write(controller, stream[first : first + size])
            sent = due

    thread = threading.Thread(target=send)
    thread.start()
    yield os.ttyname(other)
    ended.set()
    thread.join()
    os.close(controller)
    os.close(other)


def test_measurements_do_not_depend_on_how_bytes_arrive_and_damaged_packets_are_left_out() -> None:
    stream = bytearray(turn() + turn())
    whole = Xv11Decoder().feed(bytes(stream))
    stream[100] ^= 1
    decoder = Xv11Decoder()
    pieces = [decoder.feed(bytes(stream[k : k + 7])).samples for k in range(0, len(stream), 7)]
    assert len(whole) == 720
    assert sum(map(len, pieces)) == 716
    assert decoder.counters.checksum_failures == 1


def test_scans_arrive_from_a_port(port: str) -> None:
    source = drivers.open(f"xv11:{port}?mount=0.1,0,0")
    scans = []
    for message in source:
        assert isinstance(message, Scan)
        scans.append(message)
        if len(scans) == 3:
            source.stop()
    for scan in scans[:3]:
        assert len(scan.ranges) == 360
        assert np.isnan(scan.ranges[np.argmin(np.abs(scan.angles - np.pi / 2))])
        assert np.nanmax(np.abs(scan.ranges - RANGE)) < 1e-9
        np.testing.assert_array_equal(scan.mount, [0.1, 0.0, 0.0])
    assert scans[2].stamp - scans[1].stamp == pytest.approx(TURN_DURATION, abs=0.05)
