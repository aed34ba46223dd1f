"""Options of `wclm live` alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

RecordFileOption = Annotated[
    Path | None, typer.Option("--record", metavar="FILE.mcap", help="Recording of all measurements.")
]
DriveOption = Annotated[bool, typer.Option("--drive", help="Drive the robot with the arrow keys.")]
ServeOption = Annotated[
    bool, typer.Option("--serve/--no-serve", help="Serve the review log to viewers during the run.")
]
AddressOption = Annotated[str, typer.Option("--address", help="Address for viewers; 0.0.0.0 admits other computers.")]
PortOption = Annotated[
    int | None,
    typer.Option(
        "--port", min=1, max=65535, help="Port for viewers; by default 9877, or a free one if that is in use."
    ),
]
WebOption = Annotated[bool, typer.Option("--web", help="Serve a page that shows the run in a browser.")]
WebAddressOption = Annotated[
    str | None,
    typer.Option(
        "--web-address",
        metavar="HOST[:PORT]",
        help="Address of the page, by default 127.0.0.1:8090; with any other than this computer's own, as 0.0.0.0, "
        "the URL contains a token.",
    ),
]
StatusOption = Annotated[
    Path | None,
    typer.Option("--status", metavar="FILE.json", help="File with the state of the run, written once a second."),
]
