"""`wclm report`: a session as one page for the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..options import OverwriteOption


def report(
    session: Annotated[Path, typer.Argument(help="The directory that `wclm run --out DIR` left.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.html", help="Without it: report.html in SESSION.")
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write a session's page, report.html: map, path, loops, times, errors, and what looked wrong.

    A run writes it already; this is for directories of older versions. The page needs no network.

    Example: [bold]wclm report results/intel --overwrite[/bold]
    """
    from ...io.output_dir import REPORT, unfinished_file
    from ...io.run_results import read_run_results
    from ...visualisation.report_page import write_page

    read = read_run_results(session)
    target = out or session / REPORT
    with unfinished_file(target, overwrite) as unfinished:
        write_page(unfinished, read)
    typer.echo(f"{target}")
