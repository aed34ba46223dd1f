"""Messages of commands on stderr."""

import io
import threading

import pytest
from rich.console import Console
from rich.live import Live

from slam.cli.console import print_if_slow, print_message


def wait_for_timers() -> None:
    """Wait until all timers have run or were cancelled."""
    for thread in threading.enumerate():
        if isinstance(thread, threading.Timer):
            thread.join(30.0)
            assert not thread.is_alive()


def test_a_message_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    print_message("two\n  lines")
    assert capsys.readouterr().err == "wclm: two lines\n"


def test_a_fast_block_prints_nothing(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slam.cli.console.SLOW_SECONDS", 120.0)
    with print_if_slow("compiling"):
        pass
    wait_for_timers()
    assert capsys.readouterr().err == ""


def test_a_slow_block_prints_a_message(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slam.cli.console.SLOW_SECONDS", 0.0)
    with print_if_slow("compiling"):
        wait_for_timers()
    assert capsys.readouterr().err == "wclm: compiling\n"


def test_control_characters_do_not_reach_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    print_message("topic /scan\x1b]0;title\x07\u202e of Zürich")
    assert capsys.readouterr().err == "wclm: topic /scan\ufffd]0;title\ufffd\ufffd of Zürich\n"


def test_a_message_is_printed_above_a_live_table() -> None:
    screen = io.StringIO()
    with Live("table", console=Console(file=screen, force_terminal=True), transient=True):
        print_message("the lidar is lost")
    assert "wclm: the lidar is lost\n" in screen.getvalue()
