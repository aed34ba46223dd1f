"""Devices through pseudo terminals, pyserial and a process of their own: complete, in order, with the right stamps, and
reconnected after every fault.
"""

from __future__ import annotations

import ctypes
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import drivers
from drivers import DriverError, Message, Odometry, Scan
from drivers.devices.acquisition import Acquisition
from drivers.devices.device_spec import parse_devices
from drivers.devices.packet_stamper import SETTLING_SECONDS
from drivers.devices.snapshot import Snapshot
from drivers.devices.supervisor import DeviceState
from drivers.realtime import realtime_priority

from .device_peers import Ld06Peer, plugged

RATE, TURNS = 9200.0, 9.7
METRES_PER_READING = 10 * 0.444565e-3
BASE_PERIOD = 0.015


def receive_for(acquisition: Acquisition, seconds: float) -> list[Message]:
    messages = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        message = acquisition.receive(0.05)
        if message is not None:
            messages.append(message)
    return messages


def receive_until(acquisition: Acquisition, condition: Callable[[], bool], timeout: float = 20.0) -> list[Message]:
    messages: list[Message] = []
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, acquisition.snapshot
        messages += receive_for(acquisition, 0.05)
    return messages


def revolution_of(scan: Scan) -> int:
    return round((float(np.median(scan.ranges)) - 1.0) / 0.002)


def errors_of_stamps(messages: list[Message], lidar_begun: float, base_begun: float) -> np.ndarray:
    """Return the stamp errors in seconds; the devices encode the time of measurement in their measurements."""
    offset = time.time() - time.monotonic()
    odometry = [message for message in messages if isinstance(message, Odometry)]
    counts = np.array([round(message.pose[0] / METRES_PER_READING) for message in odometry])
    # Odometry starts at zero, whichever reading was the first. A busy host stamps single readings, such as the first
    # ones, late by more than half a period, so all stamps together determine the number of the reading at zero.
    stamps = np.array([message.stamp for message in odometry]) - offset - base_begun
    reading_at_zero = round(float(np.median(stamps / BASE_PERIOD - counts)))
    errors = []
    for message in messages:
        if isinstance(message, Scan):
            truth = lidar_begun + math.ceil(revolution_of(message) * RATE / TURNS) / RATE
        else:
            assert isinstance(message, Odometry)
            truth = base_begun + (reading_at_zero + round(message.pose[0] / METRES_PER_READING)) * BASE_PERIOD
        errors.append(message.stamp - offset - truth)
    return np.array(errors)


def test_messages_of_both_devices_are_complete_and_in_order(peer: Any) -> None:
    source = drivers.open(peer.spec)
    messages: list[Message] = []
    for message in source:
        messages.append(message)
        if len(messages) == 150:
            source.stop()
    assert np.all(np.diff([message.stamp for message in messages]) >= 0.0)
    revolutions = [revolution_of(message) for message in messages if isinstance(message, Scan)]
    assert len(revolutions) > 15
    assert np.all(np.diff(revolutions) == 1)
    travelled = np.array([message.pose[0] for message in messages if isinstance(message, Odometry)])
    assert len(travelled) > 100
    np.testing.assert_allclose(np.diff(travelled), METRES_PER_READING, atol=1e-9)
    assert source.report.messages == len(messages)
    assert source.report.skipped == 0
    with pytest.raises(DriverError, match="only once"):
        next(iter(source))


def test_scans_have_the_number_of_their_lidar() -> None:
    with plugged(Ld06Peer()) as one, plugged(Ld06Peer()) as other:
        source = drivers.open(f"ld06:{one}?mount=0.1,0,0 + ld06:{other}?mount=-0.1,0,0")
        places = set()
        for message in source:
            assert isinstance(message, Scan)
            assert message.mount is not None
            places.add((message.lidar, float(message.mount[0])))
            if len(places) == 2:
                source.stop()
    assert places == {(0, 0.1), (1, -0.1)}


def test_scans_are_left_out_from_the_beginning_if_paused_before() -> None:
    """A button of the page may be pressed before the devices are open."""
    with plugged(Ld06Peer()) as path:
        acquisition = Acquisition(parse_devices(f"ld06:{path}"))
        acquisition.pause(True)
        with acquisition:
            assert receive_for(acquisition, 1.0) == []
            acquisition.pause(False)
            assert receive_for(acquisition, 2.0)


@pytest.mark.slow
def test_all_counters_are_reported_and_devices_are_halted(peer: Any) -> None:
    with Acquisition(parse_devices(peer.spec)) as acquisition:
        receive_for(acquisition, 1.0)
        lidar, base = acquisition.snapshot.devices
        assert peer.scans_since_last_stop()
        (reader,) = multiprocessing.active_children()
        with realtime_priority():
            assert os.sched_getscheduler(reader.pid or 0) == os.sched_getscheduler(0)  # if permitted
    assert (lidar.state, base.state) == (DeviceState.RUNNING, DeviceState.RUNNING)
    assert "S1M1" in lidar.identity
    assert "DenseBoost" in lidar.identity
    assert "00112233445566778899AABBCCDDEEFF" in lidar.identity
    assert lidar.counters["samples"] > 5000
    assert lidar.counters["revolutions"] >= 5
    for name in ("checksum_failures", "bytes_skipped", "discarded", "implausible", "losses", "silences"):
        assert lidar.counters[name] == 0
    assert base.counters["readings"] > 40
    assert base.counters["losses"] == 0
    assert lidar.age is not None
    assert lidar.age < 1.0
    assert not peer.scans_since_last_stop()
    assert [event["speed"] for event in peer.events if event["event"] == "motor"] == [600, 0]
    assert peer.events[-1]["event"] == "motor" or "on=False" in peer.events[-1]["what"]
    assert not any("Velocity" in event.get("what", "") for event in peer.events)


@pytest.mark.slow
def test_stamps_are_right_while_the_consumer_is_busy(make_peer: Callable[..., Any]) -> None:
    """Two milliseconds at the 99th percentile, unless the whole computer was suspended.

    On a busy computer the first reads of a device may all be late. Their delay is unknown before the first prompt read,
    so the first second may contain larger errors.
    """
    for _ in range(3):
        peer = make_peer()
        messages, snapshot = receive_with_busy_consumer(peer)
        if not was_suspended(peer, snapshot):
            break
    errors = errors_of_stamps(messages, peer.wait_for("scan")["begun"], peer.wait_for("base")["begun"])
    settled = np.array([message.stamp for message in messages]) > messages[0].stamp + 1.0
    assert snapshot.dropped == 0
    assert np.count_nonzero(settled) > 250
    assert np.quantile(np.abs(errors[settled]), 0.99) < 0.002
    assert np.quantile(np.abs(errors), 0.95) < 0.002


def receive_with_busy_consumer(peer: Any) -> tuple[list[Message], Snapshot]:
    with Acquisition(parse_devices(peer.spec)) as acquisition:
        messages: list[Message] = []
        end = time.monotonic() + 5.0
        while time.monotonic() < end:
            ctypes.PyDLL(None).usleep(150_000)  # as work does, this holds the interpreter's lock
            while (message := acquisition.receive(0.0)) is not None:
                messages.append(message)
    return messages, acquisition.snapshot


def was_suspended(peer: Any, snapshot: Snapshot) -> bool:
    """Return whether the emulated devices or the reading process did not run for a while.

    The devices lose no packets. The reading process counts a loss or a pause only if it was held up for many times the
    interval of its reads.
    """
    lidar, base = (device.counters for device in snapshot.devices)
    held_up = lidar["packets_lost"] + lidar["pauses"] + base["lost"] + base["pauses"]
    return held_up > 0 or any(event["event"] == "frozen" for event in peer.events)


@pytest.mark.slow
def test_stamps_are_right_after_a_short_silence(peer: Any) -> None:
    """Devices without device time lose half a second of data; afterwards their stamps and the travelled distance are
    right.
    """
    with Acquisition(parse_devices(peer.spec)) as acquisition:
        receive_for(acquisition, 3.0)
        before = receive_for(acquisition, 0.5)
        peer.send_command("stall lidar 0.5")
        peer.send_command("stall base 0.5")
        after = receive_for(acquisition, 4.0)
        lidar, base = acquisition.snapshot.devices
    assert lidar.counters["losses"] == base.counters["losses"] == 0
    assert lidar.counters["packets_lost"] == pytest.approx(0.5 * RATE / 40, abs=15)
    assert base.counters["lost"] == pytest.approx(0.5 / BASE_PERIOD, abs=4)
    assert base.counters["resets"] == 0
    errors = errors_of_stamps(before + after, peer.wait_for("scan")["begun"], peer.wait_for("base")["begun"])
    assert np.quantile(np.abs(errors), 0.98) < 0.002


@pytest.mark.slow
def test_devices_are_reconnected_after_the_computer_was_held_up(peer: Any) -> None:
    with Acquisition(parse_devices(peer.spec)) as acquisition:
        receive_for(acquisition, 1.0)
        reader = multiprocessing.active_children()[0].pid
        assert reader is not None
        os.kill(reader, signal.SIGSTOP)
        time.sleep(2.5)
        os.kill(reader, signal.SIGCONT)
        receive_until(acquisition, lambda: all(d.counters["connections"] == 2 for d in acquisition.snapshot.devices))
        assert [d.counters["pauses"] for d in acquisition.snapshot.devices] == [1, 1]
        after = receive_for(acquisition, 1.5)
    begun = peer.wait_for("scan", times=2)["begun"]
    errors = errors_of_stamps(after, begun, peer.wait_for("base")["begun"])
    assert np.quantile(np.abs(errors), 0.9) < 0.002


@pytest.mark.slow
def test_damaged_bytes_lose_only_their_own_packets(make_peer: Callable[..., Any]) -> None:
    """One byte in 10 000 is dropped, inserted or flipped: all are counted, stamps and ranges are right."""
    peer = make_peer("--noise")
    with Acquisition(parse_devices(peer.spec)) as acquisition:
        messages = receive_for(acquisition, 20.0)
        lidar, base = acquisition.snapshot.devices
    errors = errors_of_stamps(messages, peer.wait_for("scan")["begun"], peer.wait_for("base")["begun"])
    assert np.quantile(np.abs(errors), 0.99) < 0.002
    assert lidar.counters["checksum_failures"] > 5
    assert lidar.counters["losses"] == base.counters["losses"] == 0
    revolutions = [revolution_of(message) for message in messages if isinstance(message, Scan)]
    assert len(revolutions) + lidar.counters["incomplete_revolutions"] > 180
    assert len(revolutions) > 175
    for message in messages:
        if isinstance(message, Scan):
            own = 1.0 + 0.002 * revolution_of(message)
            assert np.nanmax(np.abs(message.ranges - own)) < 0.0021


def test_unplugged_devices_are_reconnected(peer: Any) -> None:
    with Acquisition(parse_devices(peer.spec)) as acquisition:
        receive_for(acquisition, 0.5)
        peer.send_command("unplug lidar 0.7")
        peer.send_command("unplug base 0.7")
        receive_until(acquisition, lambda: {d.state for d in acquisition.snapshot.devices} == {DeviceState.LOST})
        receive_until(acquisition, lambda: {d.state for d in acquisition.snapshot.devices} == {DeviceState.RUNNING})
        messages = receive_for(acquisition, 1.0)
        devices = acquisition.snapshot.devices
    assert sum(isinstance(message, Scan) for message in messages) > 4
    assert sum(isinstance(message, Odometry) for message in messages) > 30
    for device in devices:
        assert device.counters["losses"] == 1
        assert device.counters["connections"] == 2
        assert device.problem.startswith(device.port)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "silent"),
    [
        ("restart lidar", True),
        ("stall base 1.5", True),
        ("garbage lidar", False),
    ],
)
def test_faults_are_counted_and_devices_recover(peer: Any, fault: str, silent: bool) -> None:
    index = 0 if fault.split()[1] == "lidar" else 1
    with Acquisition(parse_devices(peer.spec)) as acquisition:
        receive_for(acquisition, 0.5)
        peer.send_command(fault)

        def seen() -> bool:
            device = acquisition.snapshot.devices[index]
            noticed = device.counters["silences"] if silent else device.counters["bytes_skipped"]
            return noticed > 0 and device.state is DeviceState.RUNNING

        receive_until(acquisition, seen)
        messages = receive_for(acquisition, 0.8 + SETTLING_SECONDS)
    assert {type(message) for message in messages} == {Scan, Odometry}
    revolutions = [revolution_of(message) for message in messages if isinstance(message, Scan)]
    assert np.all(np.diff(revolutions) >= 1)


@pytest.mark.slow
def test_a_lidar_that_reports_an_error_is_reset(make_peer: Callable[..., Any]) -> None:
    peer = make_peer("--sick")
    with Acquisition(parse_devices(f"rplidar:{peer.lidar}")) as acquisition:
        assert any(isinstance(message, Scan) for message in receive_for(acquisition, 1.0))
    assert sum(event["event"] == "reset" for event in peer.events) == 1


@pytest.mark.slow
def test_an_unresponsive_device_raises_a_one_line_error(make_peer: Callable[..., Any]) -> None:
    peer = make_peer("--deaf")
    with (
        pytest.raises(DriverError, match=r"lidar: no RPLIDAR responds here") as caught,
        Acquisition(parse_devices(f"rplidar:{peer.lidar}?baud=256000")),
    ):
        pass
    assert "\n" not in str(caught.value)
    with (
        pytest.raises(DriverError, match="no such port"),
        Acquisition(parse_devices("ld06:/dev/no")),
    ):
        pass


def test_a_lidar_with_another_serial_number_is_rejected(peer: Any) -> None:
    with (
        pytest.raises(DriverError, match=r"serial number 0011.*, not 42"),
        Acquisition(parse_devices(f"rplidar:{peer.lidar}?serial=42&baud=115200")),
    ):
        pass


def test_the_error_for_an_unknown_scan_mode_lists_the_modes(peer: Any) -> None:
    with (
        pytest.raises(DriverError, match=r"'Turbo'; it has: Standard, DenseBoost"),
        Acquisition(parse_devices(f"rplidar:{peer.lidar}?mode=Turbo&baud=115200")),
    ):
        pass


CONSUMER = """
import sys, time
import drivers
if __name__ == "__main__":
    for message in drivers.open(sys.argv[1]):
        print("message", flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_devices_are_halted_when_the_program_ends_and_can_be_restarted(peer: Any, tmp_path: Any, number: int) -> None:
    script = tmp_path / "consumer.py"
    script.write_text(CONSUMER)
    process = subprocess.Popen(
        [sys.executable, str(script), peer.spec],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        preexec_fn=lambda: signal.signal(
            signal.SIGINT, signal.SIG_DFL
        ),  # SIGINT is ignored if the tests run in the background
    )
    assert process.stdout is not None
    for _ in range(30):
        assert process.stdout.readline() == "message\n"
    os.kill(process.pid, number)
    process.wait()
    process.stdout.close()
    peer.wait_for("motor", times=2)
    assert not peer.scans_since_last_stop()
    with Acquisition(parse_devices(peer.spec)) as acquisition:
        assert any(isinstance(message, Scan) for message in receive_for(acquisition, 1.0))


@pytest.mark.slow
def test_a_lidar_that_is_still_streaming_is_restarted(peer: Any) -> None:
    """The state after a crash of all processes."""
    from drivers.lidars.rplidar.requests import express_scan
    from drivers.transport import SerialPort

    port = SerialPort(str(peer.lidar), 256000)
    port.write(express_scan(1).packet())
    peer.wait_for("scan")
    port.close()
    with Acquisition(parse_devices(f"rplidar:{peer.lidar}")) as acquisition:
        scans = receive_for(acquisition, 1.0)
    assert len(scans) > 5
    assert peer.wait_for("stop")["scanning"]
