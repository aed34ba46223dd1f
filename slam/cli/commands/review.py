"""`wclm review`: the log of a session, in the viewer, in a browser, or in a few lines."""

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
    from ...visualisation.rerun_log.viewer import ViewerServer

WEB_PORT = 9090
PATIENCE = 30.0  # seconds for a server to come up
STOPPING = 5.0  # seconds for it to end when told to


def review(
    sessions: Annotated[
        list[Path],
        typer.Argument(help="Directories that `wclm run --out DIR` left or was to leave, or log files; side by side."),
    ],
    web: Annotated[bool, typer.Option("--web", help="Serve viewer and log for a browser, until Ctrl-C.")] = False,
    address: Annotated[
        str, typer.Option("--address", help="Where the viewer listens: 0.0.0.0 lets other computers in.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option("--port", min=1, max=65535, help="Of the page of --web; 9090, or another if that is taken."),
    ] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Print closures, worst residuals and health; no viewer.")
    ] = False,
) -> None:
    """Look at the log of a session: what the robot saw and believed, and why each loop was closed or refused.

    The log of a run that was killed, or still goes on, is found by the directory that the run was to leave.

    Example: [bold]wclm review results/intel --web[/bold]
    """
    if summary:
        from ...visualisation.rerun_log.terminal_summary import summary_lines

        for session in sessions:
            typer.echo("\n".join(summary_lines(session)))
        return
    if not (web or has_display()):
        raise OutputError("there is no display for the viewer; --web serves it for a browser, --summary needs neither")
    with TemporaryDirectory(prefix="wclm-review-") as scratch:
        log = Path(scratch) / "review.rrd"
        _make_ready(sessions, log)
        if web:
            _serve(log, address, port)
        else:
            _show(log, address)


def _make_ready(sessions: list[Path], target: Path) -> None:
    from ...visualisation.rerun_log.combined_log import write_combined_log
    from ...visualisation.rerun_log.log_files import find_log

    found = [find_log(session) for session in sessions]
    for session, log in zip(sessions, found, strict=True):
        if not log.ended:
            print_message(f"{session}: the run has not ended, or was killed; this is its log in {log.directory}")
    write_combined_log(found, [session.resolve().name for session in sessions], target)


def _show(log: Path, address: str) -> None:
    """The native viewer, until it is closed."""
    from ...visualisation.rerun_log.viewer import viewer_executable

    # A port of its own: a viewer that finds another one at its port sends it what it was to show.
    with (
        _running([viewer_executable(), str(log), "--bind", address, "--port", "auto"]) as viewer,
        suppress(KeyboardInterrupt),
    ):
        viewer.wait()


def _serve(log: Path, address: str, port: int | None) -> None:
    """Viewer and log for a browser, until Ctrl-C."""
    from ...visualisation.rerun_log.viewer import ViewerServer, viewer_executable

    with ViewerServer(address) as data, ViewerServer(address, port, usual=WEB_PORT) as page:
        ports = ["--port", str(data.port), "--web-viewer-port", str(page.port)]
        where = f"http://{page.host}:{page.port}/?url={quote(data.url, safe='')}"
    with _running([viewer_executable(), str(log), "--serve-web", "--bind", address, *ports]) as server:
        for served in (data, page):
            _wait_for(served, server)
        typer.echo(where)
        print_message("Ctrl-C ends it")
        with suppress(KeyboardInterrupt):
            server.wait()


@contextmanager
def _running(command: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """A program that ends with the block. Raises OutputError where it cannot be started."""
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
            process.wait(STOPPING)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _wait_for(served: ViewerServer, process: subprocess.Popen[bytes]) -> None:
    """Until somebody answers there. Raises OutputError where that does not happen."""
    deadline = time.monotonic() + PATIENCE
    while not served.accepts_connections():
        if process.poll() is not None or time.monotonic() > deadline:
            raise OutputError(f"{served.address}:{served.port}: the viewer's server does not come up")
        time.sleep(0.05)
