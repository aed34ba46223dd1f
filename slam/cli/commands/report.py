"""`wclm report`: the report page of a session."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..options import OverwriteOption


def report(
    session: Annotated[Path, typer.Argument(help="Output directory of `wclm run`.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.html", help="Output file; by default report.html in SESSION.")
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write the report page of a session: map, path, loop closures, times, errors and warnings.

    Every run writes it; this command is for output directories of older versions. The page needs no network.

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
