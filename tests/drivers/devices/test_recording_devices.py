"""`wclm record`: content of the file if the recorder is killed or stopped, or the disk is full; `wclm devices`."""

from __future__ import annotations

import multiprocessing
import os
import random
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import Message, Odometry, RecordingError, Scan
from drivers.devices.outbox import Outbox
from drivers.messages import SourceReport
from drivers.recordings.mcap import McapReader, McapWriter

WCLM = [sys.executable, "-c", "from slam.cli import main; main()"]
LARGEST_DELAY = 0.3
"""Seconds from a measurement to the recorder's queue: a revolution and the messages measured during it."""


def start(peer: Any, path: Path, **options: Any) -> subprocess.Popen[str]:
    command = [*WCLM, "record", "--lidar", f"rplidar:{peer.lidar}", "--base", f"create2:{peer.base}", str(path)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def wait_until_recording(path: Path, process: subprocess.Popen[str]) -> None:
    end = time.monotonic() + 30.0
    while not path.exists() or path.stat().st_size < 10_000:
        assert time.monotonic() < end
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)


def kill_and_read(peer: Any, path: Path, after: float) -> float:
    """Record, kill the recorder and read the file; return the seconds lost before the kill."""
    process = start(peer, path, start_new_session=True)
    wait_until_recording(path, process)
    time.sleep(after)
    killed = time.time()
    os.killpg(process.pid, signal.SIGKILL)
    out, err = process.communicate()
    assert out + err == ""
    source = McapReader(path)
    messages = list(source)
    assert {type(message) for message in messages} == {Scan, Odometry}
    assert "is truncated" in str(source.report.first)
    assert source.report.skipped == 1
    return killed - messages[-1].stamp


def assert_last_second_is_lost_at_most(peer: Any, path: Path, after: float) -> None:
    """Try up to three times, because a busy computer may suspend the recorder before it is killed."""
    losses = []
    while len(losses) < 3:
        losses.append(kill_and_read(peer, path.with_suffix(f".{len(losses)}.mcap"), after))
        if losses[-1] < 1.0 + LARGEST_DELAY:
            return
    raise AssertionError(f"lost {losses} s")


@pytest.mark.parametrize("after", [0.3, pytest.param(1.15, marks=pytest.mark.slow)])
def test_a_killed_recorder_loses_the_last_second_at_most(peer: Any, tmp_path: Path, after: float) -> None:
    assert_last_second_is_lost_at_most(peer, tmp_path / "a.mcap", after)


@pytest.mark.slow
def test_recorders_killed_at_random_times_lose_the_last_second_at_most(peer: Any, tmp_path: Path) -> None:
    times = random.Random(4)
    for k in range(20):
        assert_last_second_is_lost_at_most(peer, tmp_path / f"{k}.mcap", times.uniform(0.0, 3.0))


def test_a_recording_goes_on_while_the_command_is_stopped_and_ends_if_it_is_killed(peer: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    process = start(peer, path)
    wait_until_recording(path, process)
    process.send_signal(signal.SIGSTOP)
    stopped = time.time()
    while last_stamp(path) < stopped + 0.5:
        assert time.time() < stopped + 30.0
        time.sleep(0.1)
    process.kill()
    process.communicate()
    while (report := list_messages(path)[1]).skipped:  # truncated until the other process has closed the file
        assert time.time() < stopped + 60.0
        time.sleep(0.1)
    assert report.first is None
    odometry = [message.stamp for message in list_messages(path)[0] if isinstance(message, Odometry)]
    assert np.diff(odometry).max() < 10 * np.median(np.diff(odometry))


def last_stamp(path: Path) -> float:
    return list_messages(path)[0][-1].stamp


def list_messages(path: Path) -> tuple[list[Message], SourceReport]:
    source = McapReader(path)
    return list(source), source.report


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_signal_ends_the_recording_with_a_complete_file(peer: Any, tmp_path: Path, number: int) -> None:
    path = tmp_path / "a.mcap"
    process = start(peer, path)
    wait_until_recording(path, process)
    process.send_signal(number)
    out, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")
    source = McapReader(path)
    messages = list(source)
    scans = sum(isinstance(message, Scan) for message in messages)
    assert out.startswith(f"{path}: {scans} scans and {len(messages) - scans} odometry readings in ")
    assert len(source) == len(messages)
    assert source.report.skipped == 0
    assert not peer.scans_since_last_stop()
    assert b"DiagnosticArray" in path.read_bytes()


def test_a_full_disk_ends_the_recording_and_keeps_the_file(peer: Any, tmp_path: Path) -> None:
    path, limit = tmp_path / "a.mcap", 150_000
    process = start(peer, path, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)))
    out, err = process.communicate(timeout=120)
    assert (process.returncode, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith(f"wclm: {path}: cannot be written: File too large; the recording ends after ")
    source = McapReader(path)
    assert {type(message) for message in source} == {Scan, Odometry}
    assert path.stat().st_size <= limit
    assert not peer.scans_since_last_stop()


def write_until_full(writer: McapWriter, size: int) -> list[float]:
    """Write readings until the file is larger than `size` bytes, which fails; return the stamps of those written."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    written: list[float] = []

    def write_without_end() -> None:
        while True:
            writer.write(Odometry(len(written) / 100, np.zeros(3)))
            written.append(len(written) / 100)

    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        with pytest.raises(RecordingError, match="File too large"):
            write_without_end()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    return written


def test_a_disk_that_is_full_before_the_first_flush_leaves_an_mcap_file_without_messages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy computer more may be written at once than there is room for."""
    monkeypatch.setattr("drivers.recordings.mcap.FLUSH_PERIOD", np.inf)
    path = tmp_path / "a.mcap"
    assert write_until_full(McapWriter(path), 1_000)
    with pytest.raises(RecordingError, match=r"contains no readable .* truncated"):
        list(McapReader(path))


def test_the_writer_keeps_whole_chunks_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.recordings.mcap.FLUSH_PERIOD", 0.0)
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    written = write_until_full(writer, 20_000)
    assert [message.stamp for message in McapReader(path)] == written
    with pytest.raises(RecordingError, match="closed"):
        writer.write(Odometry(1e3, np.zeros(3)))
    writer.close()


@pytest.mark.slow
def test_a_recording_that_never_started_leaves_no_file(tmp_path: Path, make_peer: Callable[..., Any]) -> None:
    peer = make_peer()
    peer.lidar.unlink()
    process = start(peer, tmp_path / "a.mcap")
    out, err = process.communicate(timeout=120)
    assert (process.returncode, out) == (2, "")
    assert err == f"wclm: {peer.lidar}: no such port; is the device plugged in?\n"
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.slow
def test_watching_devices_ends_with_all_counters(peer: Any) -> None:
    command = [*WCLM, "devices", f"rplidar:{peer.lidar}", f"create2:{peer.base}", "--watch", "--for", "0.8"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert (result.returncode, result.stderr) == (0, "")
    counts = dict(line.split() for line in result.stdout.splitlines() if len(line.split()) == 2)
    assert int(counts["samples"]) > 2000
    assert int(counts["readings"]) > 10
    for name in ("checksum_failures", "bytes_skipped", "packets_lost", "silences", "losses", "clock_jumps", "resets"):
        assert counts[name] == "0"
    assert not peer.scans_since_last_stop()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can mount a small disk")
@pytest.mark.slow
def test_a_small_disk_that_fills_up_ends_the_recording(peer: Any, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=12m", "tmpfs", disk], capture_output=True).returncode:
        pytest.skip("cannot mount")
    try:
        process = start(peer, disk / "a.mcap")
        wait_until_recording(disk / "a.mcap", process)
        subprocess.run(["dd", "if=/dev/zero", "of=" + str(disk / "filler"), "bs=4096"], capture_output=True)
        _, err = process.communicate(timeout=120)
        assert process.returncode == 2
        assert "No space left on device; the recording ends after " in err
        assert {type(message) for message in McapReader(disk / "a.mcap")} == {Scan, Odometry}
    finally:
        subprocess.run(["umount", disk], check=True)


def test_the_oldest_messages_for_a_stopped_consumer_are_dropped_and_counted() -> None:
    consumer, sender = multiprocessing.Pipe()
    outbox = Outbox(sender, capacity=100)
    size, count = 10_000, 200  # bytes, more in total than a pipe holds
    for k in range(count):
        outbox.put(Scan(float(k), np.zeros(size), np.zeros(size), np.zeros(size), 0.1, 30.0))
    received = threading.Thread(target=outbox.close)
    received.start()
    stamps = [consumer.recv().stamp for _ in range(count - outbox.dropped)]
    received.join()
    assert 95 <= outbox.dropped <= 100
    assert stamps == sorted(stamps)
    assert stamps[-100:] == list(range(100, 200))
    sender.close()
    assert not outbox.broken


def test_a_consumer_that_has_ended_is_noticed() -> None:
    consumer, sender = multiprocessing.Pipe()
    consumer.close()
    outbox = Outbox(sender)
    outbox.put(Odometry(1.0, np.zeros(3)))
    outbox.close()
    assert outbox.broken
