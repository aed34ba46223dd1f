"""`wclm review`: the review log of a session in the viewer, in a browser, or as text."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated
from urllib.parse import quote

import typer

from ...errors import OutputError
from ..console import print_message
from ..viewer import has_display

if TYPE_CHECKING:
    from ...visualisation.rerun_log.log_files import LogFiles
    from ...visualisation.rerun_log.viewer import ViewerServer

WEB_PORT = 9090
START_ATTEMPTS = 3
"""Starts of the viewer's server: another program may take a port after it was found free."""
START_TIMEOUT = 30.0
"""Seconds until a server must be reachable."""
STOP_TIMEOUT = 5.0
"""Seconds until a terminated server is killed."""


def review(
    sessions: Annotated[
        list[Path],
        typer.Argument(
            metavar="SESSION",
            help="Output directories of `wclm run`, also unfinished, or log files; shown side by side.",
        ),
    ],
    web: Annotated[bool, typer.Option("--web", help="Serve viewer and log for a browser until Ctrl-C.")] = False,
    address: Annotated[
        str, typer.Option("--address", help="Address of the viewer; 0.0.0.0 admits other computers.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(
            "--port",
            min=1,
            max=65535,
            help="Port of --web; by default 9090, or a free one if that is in use.",
        ),
    ] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Print loop closures, largest residuals and health as text instead.")
    ] = False,
) -> None:
    """Open the review log of a session in the viewer.

    The log shows scans, map and estimate over time, and the tests of each loop closure. The log of a run that was
    killed or is still running is found by the output directory of the run.

    Example: [bold]wclm review results/intel --web[/bold]
    """
    if summary:
        from ...visualisation.rerun_log.terminal_summary import summary_lines

        for session in sessions:
            typer.echo("\n".join(summary_lines(session)))
        return
    logs = _find_logs(sessions)
    if not (web or has_display()):
        raise OutputError("no display for the viewer; use --web for a browser or --summary for text")
    from ...visualisation.rerun_log.combined_log import write_combined_log

    with TemporaryDirectory(prefix="wclm-review-") as scratch:
        log = Path(scratch) / "review.rrd"
        write_combined_log(logs, [session.resolve().name for session in sessions], log)
        if web:
            _serve(log, address, port)
        else:
            _show(log, address)


def _find_logs(sessions: list[Path]) -> list[LogFiles]:
    from ...visualisation.rerun_log.log_files import find_log

    found = [find_log(session) for session in sessions]
    for session, log in zip(sessions, found, strict=True):
        if not log.ended:
            print_message(f"{session}: the run is not finished or was killed; using its log in {log.directory}")
    return found


def _show(log: Path, address: str) -> None:
    """Run the native viewer until it is closed."""
    from ...visualisation.rerun_log.viewer import viewer_executable

    # A port of its own: a viewer that finds another one at its port sends the log to that one.
    with (
        _running([viewer_executable(), str(log), "--bind", address, "--port", "auto"]) as viewer,
        suppress(KeyboardInterrupt),
    ):
        viewer.wait()


def _serve(log: Path, address: str, port: int | None) -> None:
    """Serve viewer and log for a browser until Ctrl-C."""
    from ...visualisation.rerun_log.viewer import ViewerServer, viewer_executable

    for later_attempts in reversed(range(START_ATTEMPTS)):
        with ViewerServer(address) as data, ViewerServer(address, port, default=WEB_PORT) as page:
            ports = ["--port", str(data.port), "--web-viewer-port", str(page.port)]
            where = f"http://{page.host}:{page.port}/?url={quote(data.url, safe='')}"
        with _running([viewer_executable(), str(log), "--serve-web", "--bind", address, *ports]) as server:
            try:
                for served in (data, page):
                    _wait_for(served, server)
            except OutputError:
                if server.poll() is None or not later_attempts:
                    raise
                continue
            typer.echo(where)
            print_message("serving until Ctrl-C")
            with suppress(KeyboardInterrupt):
                server.wait()
            return


@contextmanager
def _running(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run a program until the block ends. Raises OutputError if it cannot be started."""
    try:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
    except OSError as error:
        raise OutputError(f"the viewer cannot be started: {error}") from error
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _wait_for(served: ViewerServer, process: subprocess.Popen[bytes]) -> None:
    """Wait until the server is reachable. Raises OutputError if it ends or START_TIMEOUT is over."""
    deadline = time.monotonic() + START_TIMEOUT
    while not served.accepts_connections():
        if process.poll() is not None or time.monotonic() > deadline:
            raise OutputError(f"{served.address}:{served.port}: the viewer's server cannot be reached")
        time.sleep(0.05)
