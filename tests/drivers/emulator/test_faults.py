"""Lines, ports and faults: all faults are counted, and every byte is accounted for."""

from __future__ import annotations

import json
import os
import threading
import time as clocks
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.bases import Create2
from drivers.emulator import Emulator, EmulatorSetup, FaultEvent
from drivers.emulator.pty_port import PtyPort
from drivers.emulator.serial_line import MAX_BACKLOG, Corruptor, SerialLine
from drivers.errors import ConnectionLostError, DriverError, PortError, RecordingError
from drivers.lidars import ld06
from drivers.lidars.rplidar.decoding import decoder_for
from drivers.lidars.rplidar.requests import SCAN, express_scan
from drivers.lidars.rplidar.responses import ResponseReader, ResponseType
from drivers.transport import SerialPort

from .conftest import EXACT, Bench, Host

MakeBench = Callable[..., Bench]


# -- lines ----------------------------------------------------------------------------------------------------------


@given(st.lists(st.integers(1, 40), min_size=1, max_size=20), st.sampled_from([9600, 115200, 1_000_000]), st.data())
@settings(max_examples=50, deadline=None)
def test_a_line_carries_bytes_in_order_at_its_pace(sizes: list[int], baud: int, data: st.DataObject) -> None:
    line = SerialLine(baud)
    sent = b""
    free = 0.0
    ends = []
    for size in sizes:
        ready = data.draw(st.floats(max(0.0, free - 0.01), free + 0.01))
        packet = bytes(size)
        line.send(packet, ready)
        sent += packet
        for _ in range(size):
            free = max(free, ready) + 10 / baud
            ends.append(free)
    time, came = 0.0, 0
    while came < len(sent):
        time += data.draw(st.floats(1e-4, 0.02))
        came += len(line.read(time))
        assert came == pytest.approx(np.searchsorted(ends, time), abs=1)
    assert line.read(time + 1.0) == b""
    assert line.due == np.inf


def test_packets_sent_together_and_singly_take_the_same_time() -> None:
    realtime_priority, singly = SerialLine(115200), SerialLine(115200)
    times = np.array([0.0, 1e-4, 1e-2, 1e-2, 2e-2])
    data = bytes(range(25))
    realtime_priority.send(data, times)
    for i, time in enumerate(times):
        singly.send(data[5 * i : 5 * i + 5], float(time))
    for moment in np.arange(0.0, 0.03, 1e-4):
        assert realtime_priority.read(float(moment)) == singly.read(float(moment))


def test_overflow_of_a_slow_line_is_counted() -> None:
    line, sent = SerialLine(9600), 0
    for i in range(2000):
        line.send(bytes(10), i * 1e-3)  # ten times the line's capacity
        sent += 10
    came = len(line.read(1e9))
    assert came + line.overflow == sent
    assert came == pytest.approx((2.0 + MAX_BACKLOG) * 960, rel=0.02)


CHANCE = st.floats(0.0, 0.3)


@given(st.binary(max_size=2000), CHANCE, CHANCE, CHANCE, st.lists(st.integers(0, 2000), max_size=5))
@settings(max_examples=50, deadline=None)
def test_corruption_does_not_depend_on_chunks(
    data: bytes, drop: float, insert: float, flip: float, cuts: list[int]
) -> None:
    whole = Corruptor(drop, insert, flip, np.random.default_rng(1))
    parts = Corruptor(drop, insert, flip, np.random.default_rng(1))
    cuts = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    damaged = whole(data)
    assert b"".join(parts(data[a:b]) for a, b in pairwise(cuts)) == damaged
    assert whole.counts == parts.counts
    assert len(damaged) == len(data) - whole.counts.dropped + whole.counts.inserted


def test_each_kind_of_corruption_is_counted() -> None:
    data = bytes(1000)
    flipper = Corruptor(0.0, 0.0, 0.1, np.random.default_rng(0))
    bits = np.unpackbits(np.frombuffer(flipper(data), np.uint8)).sum()
    assert flipper.counts.flipped == bits
    assert 60 < bits < 140
    dropper = Corruptor(0.1, 0.0, 0.0, np.random.default_rng(0))
    assert dropper(data) == bytes(1000 - dropper.counts.dropped)
    inserter = Corruptor(0.0, 0.1, 0.0, np.random.default_rng(0))
    assert len(inserter(data)) == 1000 + inserter.counts.inserted
    assert Corruptor(0.0, 0.0, 0.0, np.random.default_rng(0))(data) is data


# -- ports ----------------------------------------------------------------------------------------------------------


def test_a_port_replaces_links_but_no_other_files(tmp_path: Path) -> None:
    link = tmp_path / "ports" / "lidar"
    link.parent.mkdir()
    link.symlink_to("/dev/pts/none")  # left by a killed program
    port = PtyPort(link)
    assert not port.is_open
    with_program = SerialPort(str(link), 256000)
    assert port.is_open
    assert port.baud == 256000
    other = PtyPort(link)  # another emulator replaced the link
    port.unplug()
    assert link.exists()
    other.unplug()
    assert not link.is_symlink()
    with pytest.raises(ConnectionLostError):
        with_program.read(1.0)
    with_program.close()
    assert (other.read(), other.write(b"x"), other.baud, other.is_plugged) == (b"", 0, None, False)
    link.write_text("precious")
    with pytest.raises(PortError, match="exists"):
        PtyPort(link)
    assert link.read_text() == "precious"
    with pytest.raises(PortError, match="cannot be created"):
        PtyPort(link / "lidar")


def test_closed_and_unread_ports_are_counted_separately(bench: MakeBench) -> None:
    robot = bench(lidar="ld06")
    robot.go(3.0)
    counts = robot.emulator.lidar.counts
    packets = int((3.0 - 1.0) * 375)
    assert counts.unheard == pytest.approx(packets * 47, abs=94)
    assert counts.sent == counts.overrun == 0
    host = robot.open("lidar", ld06.LD06.baud)
    robot.hosts.remove(host)  # open, but not read
    unheard = counts.unheard
    robot.go(3.0)
    assert counts.unheard == unheard
    assert counts.sent + counts.overrun == pytest.approx(3.0 * 375 * 47, rel=0.01)
    assert 4096 < counts.sent < 32768
    total = len(host.read())
    while more := host.read():
        total += len(more)
    assert total == counts.sent
    robot.hosts.append(host)
    robot.go(0.5)
    decoder = ld06.Ld06Decoder()
    decoder.feed(host.data)
    assert decoder.counters.packets > 0.5 * 375 * 0.98  # the decoder synchronises again
    assert len(host.data) == counts.sent


# -- faults ---------------------------------------------------------------------------------------------------------


def scanning(robot: Bench) -> Host:
    """Return the host of a scanning S1 with dense capsules."""
    host = robot.open("lidar", 256000)
    robot.go(0.6)
    assert host.ask(express_scan(1), ResponseReader(ResponseType.DENSE, multiple=True)) == b""
    host.forget()
    return host


def test_corrupted_bytes_arrive_as_counted(bench: MakeBench) -> None:
    streams = []
    for chances in ({}, {"drop": 2e-4, "insert": 2e-4, "flip": 2e-4}):
        robot = bench(lidar="ld06", seed=4, **chances)
        host = robot.open("lidar", ld06.LD06.baud)
        robot.go(5.0)
        streams.append(host.data)
    counts = robot.emulator.lidar.report()
    clean, damaged = streams
    damage = [counts["dropped"], counts["inserted"], counts["flipped"]]
    assert all(5 <= count <= 30 for count in damage)  # 14 of each are expected
    assert len(damaged) == len(clean) - damage[0] + damage[1] == counts["sent"]
    decoder = ld06.Ld06Decoder()
    decoder.feed(damaged)
    lost = len(clean) // 47 - decoder.counters.packets
    assert 0.8 * sum(damage) <= lost <= 1.1 * sum(damage)  # a fault loses its packet; two faults may be in one packet


def test_unplugged_devices_return(bench: MakeBench) -> None:
    events = (FaultEvent("unplug", "lidar", 3.0, 1.0), FaultEvent("unplug", "base", 3.0, 1.0))
    robot = bench(events=events)
    lidar, base = scanning(robot), robot.open("base")
    base.write(Create2().start())
    robot.go(2.9 - robot.time)
    robot.hosts.clear()
    robot.go(0.2)
    for host in (lidar, base):
        assert not host.link.port.path.is_symlink()
        with pytest.raises(ConnectionLostError):
            host.port.read(0.1)
        with pytest.raises(PortError, match="no such port"):
            SerialPort(str(host.link.port.path), 115200)
    robot.go(4.05 - robot.time)
    again, base_again = robot.open("lidar", 256000), robot.open("base")
    robot.go(1.0)
    assert again.data.startswith(b"RP LIDAR System")  # powered by the port, so it has restarted
    assert len(base_again.data) == pytest.approx(1.0 / 0.015 * 9, abs=18)  # powered by a battery, so it never stopped
    counts = [robot.emulator.lidar.counts, robot.emulator.base.counts]
    assert [c.unplugs for c in counts] == [1, 1]
    assert counts[1].unplugged == pytest.approx(1.0 / 0.015 * 9, abs=18)
    assert robot.emulator.lidar.report()["starts"] == 2


def test_stalls_and_restarts_are_counted(bench: MakeBench) -> None:
    robot = bench(events=(FaultEvent("restart", "lidar", 4.0), FaultEvent("stall", "lidar", 2.5, 0.5)))
    host = scanning(robot)
    robot.go(2.49 - robot.time)
    before = len(host.data)
    robot.go(0.5)
    assert len(host.data) - before < 400
    robot.go(1.0)
    resumed = len(host.data) - before
    assert resumed == pytest.approx(19320, rel=0.05)
    robot.go(1.5)
    assert b"RP LIDAR System" in host.data
    counts = robot.emulator.lidar.counts
    assert counts.stalled == pytest.approx(0.5 * 19320, rel=0.03)
    assert (counts.stalls, counts.restarts) == (1, 1)
    decoder = decoder_for(ResponseType.DENSE, 1 / 9200, 256000, triangulates=False)
    decoder.feed(host.data)
    assert decoder.counters.checksum_failures <= 2  # at the silence and at the restart


def test_a_failed_lidar_does_not_scan(bench: MakeBench) -> None:
    robot = bench(events=(FaultEvent("fail", "lidar", 2.5),))
    host = scanning(robot)
    robot.go(3.0 - robot.time)
    host.forget()
    assert host.ask(SCAN, ResponseReader(ResponseType.STANDARD, multiple=True)) is None
    assert host.data == b""
    assert robot.emulator.lidar.counts.fails == 1


@pytest.mark.parametrize(
    ("kind", "text"),
    [("unplug", "lidar@3"), ("stall", "lidar"), ("restart", "base@1:2"), ("fail", "head@2"), ("stall", "")],
)
def test_invalid_events_are_rejected(kind: str, text: str) -> None:
    with pytest.raises(DriverError, match=f"--{kind}"):
        FaultEvent.parse(kind, text)
    assert FaultEvent.parse("unplug", "lidar@20:3") == FaultEvent("unplug", "lidar", 20.0, 3.0)


@pytest.mark.parametrize(
    ("wrong", "because"),
    [
        ({"lidar": "sick"}, "no lidar 'sick'; there are rplidar-a1"),
        ({"base": "boat"}, "no base 'boat'"),
        ({"drive": "home"}, "no way to drive"),
        ({"drop": 0.6, "flip": 0.6}, "between 0 and 1"),
        ({"lidar_drift": 1e6}, "drift"),
        ({"seed": -1}, "seed"),
        ({"lidar": "ld06", "events": (FaultEvent("fail", "lidar", 1.0),)}, "only RPLIDARs"),
        ({"base_port": Path("a"), "lidar_port": Path("a")}, "different ports"),
    ],
)
def test_invalid_settings_are_rejected(wrong: dict[str, object], because: str) -> None:
    with pytest.raises(DriverError, match=because):
        EmulatorSetup("room", **wrong)  # type: ignore[arg-type]


# -- the whole ------------------------------------------------------------------------------------------------------


def test_ground_truth_and_report_are_written(bench: MakeBench, tmp_path: Path) -> None:
    ports = {"lidar_port": tmp_path / "lidar", "base_port": tmp_path / "base"}
    setup = EmulatorSetup("room", truth=tmp_path / "truth.tum", report=tmp_path / "report.json", **ports)
    with Emulator(setup, begun=1000.0) as emulator:
        for time in np.arange(0.0, 4.0, 0.013):
            emulator.step(float(time))
        poses = np.loadtxt(tmp_path / "truth.tum")[-50:]
        stamps, (x, y), (qz, qw) = poses[:, 0], poses[:, 1:3].T, poses[:, 6:8].T
        true = emulator.motion.poses(stamps - emulator.day)
    assert np.diff(stamps) == pytest.approx(0.02, abs=1e-6)
    assert emulator.day - 1000.0 == pytest.approx(clocks.time() - clocks.monotonic(), abs=0.05)
    assert np.column_stack([x, y, 2 * np.arctan2(qz, qw)]) == pytest.approx(true, abs=2e-6)
    assert [entry.name for entry in sorted(tmp_path.iterdir())] == ["report.json", "truth.tum"]
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["begun"] == emulator.day
    assert report["lidar"]["device"] == "rplidar-s1"
    assert report["base"]["starts"] == 1


def test_unwritable_files_are_errors(tmp_path: Path) -> None:
    ports = {"lidar_port": tmp_path / "lidar", "base_port": tmp_path / "base"}
    report = tmp_path / "report.json"
    setup = EmulatorSetup("room", truth=tmp_path, report=report, **ports)
    with pytest.raises(RecordingError, match="cannot be written"), Emulator(setup):
        pass
    setup = EmulatorSetup("room", report=tmp_path / "none" / "report.json", **ports)
    with pytest.raises(RecordingError, match="cannot be written"), Emulator(setup):
        assert setup.lidar_port.exists()
    with pytest.raises(RecordingError, match="no such world"):
        Emulator(EmulatorSetup("moon", **ports))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_bytes_keep_their_pace_in_real_time(tmp_path: Path) -> None:
    setup = EmulatorSetup("room", noise=EXACT, lidar_port=tmp_path / "lidar", base_port=tmp_path / "base")
    with Emulator(setup) as emulator:
        running = threading.Thread(target=emulator.run, args=(3.0,))
        running.start()
        with_lidar = SerialPort(str(tmp_path / "lidar"), 256000)
        with_lidar.read(1.0)  # the banner
        with_lidar.write(express_scan(1).packet())
        decoder = decoder_for(ResponseType.DENSE, 1 / 9200, 256000, triangulates=False)
        arrivals = []
        while running.is_alive():
            received = with_lidar.read(0.05)
            arrivals += [(end / 84 * 40, received.time) for end in decoder.feed(received.data).packets["end"]]
        running.join()
        with_lidar.close()
    samples, times = np.array(arrivals).T
    assert np.ptp(times) > 0.5
    half = len(times) // 2
    paces = (samples[half:] - samples[:-half]) / (times[half:] - times[:-half])
    assert np.median(paces) == pytest.approx(9200, rel=0.02)  # for any delay of single reads on a busy computer
    assert decoder.counters.checksum_failures == 0
    assert emulator.lidar.counts.overrun == 0
    assert not os.path.lexists(tmp_path / "lidar")


def test_the_report_states_how_long_the_computer_was_held_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pauses = iter([0.3])
    sleep = clocks.sleep
    monkeypatch.setattr("drivers.emulator.emulator.clocks.sleep", lambda pause: sleep(next(pauses, pause)))
    with Emulator(EmulatorSetup("room", lidar_port=tmp_path / "lidar", base_port=tmp_path / "base")) as emulator:
        assert emulator.report()["longest_pause"] == 0.0
        emulator.run(0.5)
        held_up = emulator.report()["longest_pause"]
    assert 0.3 < held_up <= emulator.report()["seconds"]
