"""Serial ports through pyserial on pseudo terminals, TCP on this host."""

from __future__ import annotations

import errno
import os
import pty
import socket
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.errors import ConnectionLostError, DriverError, PortError
from drivers.transport import (
    SerialPort,
    TcpConnection,
    Transport,
    transport,
)
from drivers.transport.transport import MAX_READS, read_promptly

ALL_BYTES = bytes(range(256))


class Peer:
    """The far end of a connection."""

    def __init__(
        self, write: Callable[[bytes], object], read: Callable[[], bytes], close: Callable[[], object]
    ) -> None:
        self.write, self.read, self.close = write, read, close


@pytest.fixture
def terminal() -> Iterator[tuple[str, int]]:
    """Yield a pseudo terminal's path and its other end."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    path = os.ttyname(theirs)
    os.close(theirs)
    yield path, ours
    with suppress(OSError):
        os.close(ours)


def serial_pair() -> tuple[Transport, Peer]:
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    port = SerialPort(os.ttyname(theirs), 115200)
    os.close(theirs)
    return port, Peer(lambda data: os.write(ours, data), lambda: os.read(ours, 65536), lambda: os.close(ours))


def tcp_pair() -> tuple[Transport, Peer]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        connection = TcpConnection(*server.getsockname()[:2])
        other, _ = server.accept()
    return connection, Peer(other.sendall, lambda: other.recv(65536), other.close)


@pytest.fixture(params=[serial_pair, tcp_pair], ids=["serial", "tcp"])
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[Transport, Peer]]:
    transport, peer = request.param()
    yield transport, peer
    transport.close()
    with suppress(OSError):
        peer.close()


def read_all(transport: Transport, count: int) -> bytes:
    data = b""
    while len(data) < count:
        received = transport.read(5.0)
        assert received.data, f"only {len(data)} of {count} bytes"
        data += received.data
    return data


def write_much(transport: Transport) -> None:
    for _ in range(100):  # the first bytes may fit into buffers
        transport.write(b"hello" * 1000)


def test_all_byte_values_are_transmitted_both_ways(pair: tuple[Transport, Peer]) -> None:
    transport, peer = pair
    peer.write(ALL_BYTES * 8)
    assert read_all(transport, 2048) == ALL_BYTES * 8
    transport.write(ALL_BYTES)
    got = b""
    while len(got) < 256:
        got += peer.read()
    assert got == ALL_BYTES


def test_read_returns_all_available_bytes_without_waiting_for_more(pair: tuple[Transport, Peer]) -> None:
    transport, peer = pair
    assert transport.read(0.01).data == b""
    peer.write(b"abc" * 100)
    time.sleep(0.02)
    before = time.monotonic()
    received = transport.read(5.0)
    assert received.data == b"abc" * 100
    assert before <= received.time <= time.monotonic() < before + 1.0


@pytest.mark.parametrize("held_up", [0, 3, 1000])
def test_bytes_that_arrive_while_the_host_is_held_up_are_read_too(
    held_up: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Then the time of the last bytes is right, unless every clock reading is late."""
    now, taken, calls = 100.0, 0, 0

    def take() -> bytes:
        nonlocal now, taken, calls
        came = round((now - 100.0) * 1000)  # one byte per millisecond
        data, taken, calls = bytes(came - taken), came, calls + 1
        now += 0.05 if calls <= held_up else 1e-5
        return data

    monkeypatch.setattr(transport, "time", SimpleNamespace(monotonic=lambda: now))
    now += 0.01
    data, arrived, complete = read_promptly(take)
    assert len(data) == taken
    assert complete == (held_up < MAX_READS)
    assert calls == min(held_up + 1, MAX_READS)
    assert arrived - (100.0 + len(data) / 1000) == pytest.approx(1e-5 if held_up < MAX_READS else 0.05)


def test_a_late_clock_reading_extends_the_read(pair: tuple[Transport, Peer], monkeypatch: pytest.MonkeyPatch) -> None:
    """Bytes that arrive while the host is held up after the first bytes belong to the same read."""
    connection, peer = pair
    looks = 0

    def monotonic() -> float:
        nonlocal looks
        looks += 1
        if looks == 2:
            peer.write(b"more")
            time.sleep(0.05)
        return time.monotonic()

    monkeypatch.setattr(transport, "time", SimpleNamespace(monotonic=monotonic))
    peer.write(b"some")
    assert connection.read(5.0).data == b"somemore"


def test_unplugging_raises_connection_lost(pair: tuple[Transport, Peer]) -> None:
    transport, peer = pair
    threading.Timer(0.05, peer.close).start()
    with pytest.raises(ConnectionLostError) as caught:
        read_all(transport, 1)
    assert str(caught.value).startswith(transport.name)
    assert "\n" not in str(caught.value)
    with pytest.raises(ConnectionLostError):
        write_much(transport)


def test_cancel_ends_a_waiting_read(pair: tuple[Transport, Peer]) -> None:
    transport, _ = pair
    threading.Timer(0.05, transport.cancel).start()
    before = time.monotonic()
    assert transport.read(10.0).data == b""
    assert time.monotonic() < before + 5.0


def test_a_closed_connection_raises_errors(pair: tuple[Transport, Peer]) -> None:
    transport, _ = pair
    transport.close()
    transport.close()
    transport.cancel()
    for use in (
        lambda: transport.read(0.1),
        lambda: transport.write(b"x"),
        lambda: transport.set_dtr(True),
        lambda: transport.pulse_rts(0.01),
    ):
        with pytest.raises(ConnectionLostError, match="closed"):
            use()


def test_modem_lines_that_do_not_exist_are_not_set(pair: tuple[Transport, Peer]) -> None:
    transport, _ = pair
    assert transport.set_dtr(True) is False
    assert transport.pulse_rts(0.01) is False


def test_a_missing_port_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(PortError, match="no such port"):
        SerialPort(str(tmp_path / "ttyUSB9"), 115200)


def test_a_file_as_port_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(PortError) as caught:
        SerialPort(str(tmp_path / "file"), 115200)
    assert isinstance(caught.value, DriverError)


def test_a_port_is_opened_exclusively(terminal: tuple[str, int]) -> None:
    first = SerialPort(terminal[0], 115200)
    with pytest.raises(PortError, match="in use"):
        SerialPort(terminal[0], 115200)
    first.close()
    SerialPort(terminal[0], 115200).close()


@pytest.mark.parametrize("baud", [57600, 115200, 230400, 256000, 460800, 1000000])
def test_all_baud_rates_can_be_set(terminal: tuple[str, int], baud: int) -> None:
    port = SerialPort(terminal[0], baud)
    os.write(terminal[1], b"ok")
    assert read_all(port, 2) == b"ok"
    port.close()


def test_an_invalid_baud_rate_is_an_error(terminal: tuple[str, int]) -> None:
    with pytest.raises(PortError):
        SerialPort(terminal[0], -1)


def test_dtr_and_rts_are_set_before_opening(terminal: tuple[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    """Pseudo terminals have no modem lines, so pyserial's methods that set them are recorded."""
    set_to: list[tuple[str, bool]] = []
    for line in ("dtr", "rts"):

        def record(port: object, line: str = line) -> None:
            set_to.append((line, getattr(port, f"_{line}_state")))

        monkeypatch.setattr(f"serial.Serial._update_{line}_state", record)
    port = SerialPort(terminal[0], 115200)
    assert set_to == [("dtr", False), ("rts", False)]
    assert port.set_dtr(True) is True
    assert set_to[-1] == ("dtr", True)
    assert port.pulse_rts(0.01) is True
    assert set_to[-2:] == [("rts", True), ("rts", False)]
    port.close()


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make pseudo terminals seem to have modem lines."""
    for line in ("dtr", "rts"):
        monkeypatch.setattr(f"serial.Serial._update_{line}_state", lambda port: None)


@pytest.mark.usefixtures("lines")
@pytest.mark.parametrize("baud", [115200, 256000])
def test_modem_lines_keep_their_state_when_the_port_is_closed(baud: int) -> None:
    ours, theirs = pty.openpty()
    port = SerialPort(os.ttyname(theirs), baud)
    attributes = termios.tcgetattr(theirs)
    attributes[2] |= termios.HUPCL
    termios.tcsetattr(theirs, termios.TCSANOW, attributes)
    assert port.set_dtr(True) is True
    assert termios.tcgetattr(theirs)[2] & termios.HUPCL == 0
    port.close()
    os.close(theirs)
    os.close(ours)


@pytest.mark.usefixtures("lines")
def test_set_dtr_raises_an_error_on_a_lost_port(terminal: tuple[str, int]) -> None:
    port = SerialPort(terminal[0], 115200)
    os.close(terminal[1])
    with pytest.raises(ConnectionLostError):
        port.set_dtr(True)
    port.close()


@pytest.mark.parametrize("failure", [ValueError("no such flag"), NotImplementedError("not on this system")])
def test_a_port_without_low_latency_mode_can_be_opened(
    failure: Exception, terminal: tuple[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[bool] = []

    def refuse(port: object, wanted: bool) -> None:
        asked.append(wanted)
        raise failure

    monkeypatch.setattr("serial.Serial.set_low_latency_mode", refuse)
    SerialPort(terminal[0], 115200).close()
    assert asked == [True]


def test_an_error_while_opening_is_a_port_error(terminal: tuple[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(port: object, wanted: bool) -> None:
        raise OSError(errno.EACCES, "refused")

    monkeypatch.setattr("serial.Serial.set_low_latency_mode", fail)
    with pytest.raises(PortError, match="permission denied"):
        SerialPort(terminal[0], 115200)


def test_a_port_that_accepts_no_bytes_is_lost(terminal: tuple[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.transport.serial_port.WRITE_TIMEOUT", 0.05)
    port = SerialPort(terminal[0], 115200)
    with pytest.raises(ConnectionLostError):
        port.write(b"x" * 200_000)
    port.close()


def test_a_refused_tcp_connection_is_an_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = server.getsockname()[:2]
    with pytest.raises(PortError, match="no connection"):
        TcpConnection(*address)
    with pytest.raises(PortError, match="no connection"):
        TcpConnection("127.0.0.1", 123456)


def test_bytes_that_may_not_be_all_are_not_complete(pair: tuple[Transport, Peer]) -> None:
    """Linux hands over some 4000 bytes of a serial port at a time."""
    connection, peer = pair
    sent = bytes(range(256)) * 40
    peer.write(sent)
    time.sleep(0.05)
    data = b""
    while len(data) < len(sent):
        received = connection.read(1.0)
        data += received.data
        assert not received.complete or len(data) == len(sent)
    assert data == sent
    peer.write(b"more")
    assert connection.read(1.0).complete
