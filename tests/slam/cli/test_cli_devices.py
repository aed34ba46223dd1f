"""`wclm devices`, `record` and `replay` without devices; with devices see tests/drivers/devices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import drivers
from drivers.devices.supervisor import DeviceState, DeviceStatus
from slam.cli.device_monitor import DeviceMonitor


class Clock:
    """Replacement of the module `time` whose time passes only in `sleep`."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def test_replay_takes_the_duration_of_the_recording(wclm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert wclm("simulate", "room", "a.mcap", "--duration", "3").exit_code == 0
    clock = Clock()
    monkeypatch.setattr("drivers.recordings.replay.time", clock)
    result = wclm("replay", "a.mcap", "--speed", "3")
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout == "a.mcap: 29 scans and 76 odometry readings, 3.0 s at 3 x\n"
    assert clock.now - 1000.0 == pytest.approx(1.0, abs=0.02)


def test_replay_yields_the_messages_of_the_recording(wclm: Any) -> None:
    assert wclm("simulate", "room", "a.mcap", "--duration", "3").exit_code == 0
    source = drivers.open("replay:a.mcap?speed=1000")
    assert len(source) == len(drivers.open("a.mcap"))
    for replayed, recorded in zip(source, drivers.open("a.mcap"), strict=True):
        assert type(replayed) is type(recorded)
        assert replayed.stamp == recorded.stamp
    wclm.refuses("info", "replay:a.mcap?speed=0", because=["the only option is speed, a positive number"])
    wclm.refuses("info", "replay:b.mcap", because=["b.mcap: no such file"])


def test_invalid_devices_are_refused(wclm: Any, tmp_path: Path) -> None:
    record = ("record", "a.mcap")
    wclm.refuses(*record, "--lidar", "lidar:/dev/a", because=["lidar:/dev/a: not a device; there are rplidar:PORT"])
    wclm.refuses(*record, "--lidar", "rplidar:/dev/nothing", because=["/dev/nothing: no such port"])
    wclm.refuses("devices", "wheels:/dev/a", because=["wheels needs wheel_radius, ticks, track"])
    wclm.refuses("devices", "ld06:/dev/nothing", because=["/dev/nothing: no such port"])
    for wrong in (record, ("record", "a.bag"), (*record, "--lidar", "create2:/dev/a"), ("devices", "--watch")):
        assert wclm(*wrong).exit_code == 2
    assert not list(tmp_path.iterdir())


def test_a_duration_of_watching_needs_watching(wclm: Any) -> None:
    wclm.refuses("devices", "--for", "3", because=["--for: has no effect without --watch"])


def test_a_recording_needs_a_name_that_other_commands_read(wclm: Any) -> None:
    lidar = ("--lidar", "ld06:/dev/nothing")
    wclm.refuses("record", "a.clf", *lidar, because=["FILE.mcap: a.clf: the name must end with .mcap"])
    wclm.refuses("live", *lidar, "--out", "map", "--record", "a.clf", because=["--record: a.clf: the name must end"])


def test_an_existing_recording_is_not_overwritten_without_the_option(wclm: Any, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_text("precious")
    wclm.refuses("record", "a.mcap", "--lidar", "ld06:/dev/nothing", because=["a.mcap: exists already"])
    wclm.refuses("record", "a.mcap", "--lidar", "ld06:/dev/nothing", "--overwrite", because=["no such port"])
    assert (tmp_path / "a.mcap").read_text() == "precious"


def test_devices_without_a_port_prints_a_message(wclm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.devices.ports.serial_ports", lambda: [])
    result = wclm("devices")
    assert (result.exit_code, result.stdout) == (0, "")
    assert result.stderr == "wclm: no serial port found; is an adapter connected?\n"


def test_device_monitor_prints_changes_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    from drivers.devices.snapshot import Snapshot

    def snapshot(state: DeviceState, problem: str = "") -> Snapshot:
        return Snapshot((DeviceStatus("ld06:/dev/a", True, state, "/dev/a", "LD06", problem, 0.1, {"messages": 3}),))

    with DeviceMonitor() as monitor:
        monitor.show(snapshot(DeviceState.RUNNING))
        monitor.show(snapshot(DeviceState.LOST, "/dev/a: connection lost"))
        monitor.show(snapshot(DeviceState.LOST, "/dev/a: connection lost"))
        monitor.show(snapshot(DeviceState.STARTING, "/dev/a: connection lost"))
        monitor.show(snapshot(DeviceState.RUNNING, "/dev/a: connection lost"))
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.splitlines() == [
        "wclm: ld06:/dev/a lost: /dev/a: connection lost",
        "wclm: ld06:/dev/a connected again on /dev/a",
    ]


def test_uarts_of_a_board_are_listed_and_its_console_is_not_probed(
    wclm: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminals = tmp_path / "class"
    tree = {
        "ttyAMA0": "soc/fe201000.serial",  # as with older kernels
        "ttyS0": "soc/fe215040.serial/fe215040.serial:0/fe215040.serial:0.0",  # with a bus of serial ports
        "ttyS4": "pnp0/00:04",  # of a PC, without an entry in a device tree
        "ttyUSB0": "soc/usb1/1-1/1-1:1.0/ttyUSB0",
    }
    for name, place in tree.items():
        device = tmp_path / "devices" / place
        device.mkdir(parents=True)
        (terminals / name).mkdir(parents=True)
        (terminals / name / "device").symlink_to(device)
    for uart in ("soc/fe201000.serial", "soc/fe215040.serial", "soc/usb1"):
        (tmp_path / "devices" / uart / "of_node").mkdir()
    (terminals / "console").mkdir()
    (terminals / "console" / "active").write_text("tty1 ttyS0\n")
    monkeypatch.setattr("drivers.devices.board_ports.TERMINALS", terminals)
    monkeypatch.setattr("drivers.devices.ports.serial_ports", list)
    monkeypatch.setattr("drivers.devices.probing.probe", lambda path: f"probed {path}")
    assert wclm("devices").stdout.splitlines() == [
        "/dev/ttyAMA0  UART of this board",
        "    probed /dev/ttyAMA0",
        "/dev/ttyS0  UART of this board, the system's console",
        "    not probed; to use it, switch the console off",
    ]
