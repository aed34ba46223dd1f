"""Byte captures: writing while a connection is used, and replay as a transport."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import EndOfCaptureError, PortError, RecordingError
from drivers.transport import CapturingTransport, Received, ReplayTransport


class ScriptedTransport:
    """A transport with scripted chunks."""

    name = "script"

    def __init__(self, chunks: list[Received]) -> None:
        self.chunks = chunks
        self.written = b""
        self.closed = False

    def read(self, timeout: float) -> Received:
        return self.chunks.pop(0)

    def write(self, data: bytes) -> None:
        self.written += data

    def set_dtr(self, asserted: bool) -> bool:
        return asserted

    def pulse_rts(self, duration: float) -> bool:
        return False

    def cancel(self) -> None:
        pass

    def close(self) -> None:
        self.closed = True


def play(player: ReplayTransport, timeout: float = 1e9) -> list[Received]:
    chunks = []
    while True:
        try:
            received = player.read(timeout)
        except EndOfCaptureError:
            return chunks
        if received.data:
            chunks.append(received)


@settings(max_examples=40, deadline=None)
@given(
    chunks=st.lists(st.tuples(st.binary(max_size=40), st.integers(0, 10**9)), max_size=20),
    timeout=st.floats(0.01, 1.0),
)
def test_a_byte_capture_is_replayed_exactly(
    tmp_path_factory: pytest.TempPathFactory, chunks: list[tuple[bytes, int]], timeout: float
) -> None:
    path = tmp_path_factory.mktemp("capture") / "a.tape"
    clock, script = 8000.0, []
    for data, wait in chunks:
        clock = round(clock + wait * 1e-9, 9)
        script.append(Received(data, clock))
    tap = CapturingTransport(ScriptedTransport([*script]), path)
    for chunk in script:
        tap.write(chunk.data[:3])
        assert tap.read(1.0) == chunk
    tap.close()
    assert tap.failure is None
    assert play(ReplayTransport(path), timeout) == [chunk for chunk in script if chunk.data]


def test_unpaced_replay_does_not_wait(tmp_path: Path) -> None:
    path = tmp_path / "a.tape"
    path.write_text("# a comment\n\n1.0 < 0102\n1.5 > ff\n100.0 < 03\n")
    player = ReplayTransport(path)
    player.write(b"whatever")
    before = time.monotonic()
    assert player.read(0.05) == Received(b"\x01\x02", 1.0)
    assert player.read(50.0) == Received(b"", 51.0)
    assert player.read(50.0) == Received(b"\x03", 100.0)
    with pytest.raises(EndOfCaptureError):
        player.read(0.1)
    assert time.monotonic() < before + 5.0


def test_paced_replay_takes_the_original_time(tmp_path: Path) -> None:
    path = tmp_path / "a.tape"
    path.write_text("1.0 < 01\n1.1 < 02\n1.2 < 03\n")
    before = time.monotonic()
    assert len(play(ReplayTransport(path, paced=True), 0.03)) == 3
    assert time.monotonic() >= before + 0.2


def test_an_incomplete_last_line_is_ignored(tmp_path: Path) -> None:
    path = tmp_path / "a.tape"
    path.write_text("1.0 < 0102\n1.1 < 03")
    assert [chunk.data for chunk in play(ReplayTransport(path))] == [b"\x01\x02"]


@pytest.mark.parametrize("line", ["1.0 < 012", "1.0 = 01", "x < 01", "1.0 <", "nan < 00", "1.0 < 01 02", "ü"])
def test_an_invalid_line_is_an_error(tmp_path: Path, line: str) -> None:
    path = tmp_path / "a.tape"
    path.write_text(f"1.0 < 01\n{line}\n")
    with pytest.raises(RecordingError) as caught:
        play(ReplayTransport(path))
    assert str(caught.value).startswith(str(path))


def test_a_missing_byte_capture_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RecordingError):
        ReplayTransport(tmp_path / "none")


def test_a_byte_capture_that_cannot_be_created_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(PortError, match="cannot be written"):
        CapturingTransport(ScriptedTransport([]), tmp_path / "none" / "a.tape")


def test_a_full_disk_ends_the_byte_capture_but_not_the_connection() -> None:
    script = ScriptedTransport([Received(b"abc", 1.0), Received(b"def", 2.0)])
    tap = CapturingTransport(script, "/dev/full")
    assert tap.read(1.0).data == b"abc"
    tap.write(b"hello")
    assert tap.failure is not None
    assert "space" in tap.failure
    assert tap.read(1.0).data == b"def"
    tap.close()
    assert script.written == b"hello"
    assert script.closed
