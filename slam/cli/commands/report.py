"""`wclm report`: the report page of a session."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..console import print_if_slow
from ..options import OverwriteOption, SessionArgument

if TYPE_CHECKING:
    from ...measuring.wall_map import WallMap


def report(
    session: SessionArgument,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.html", help="Output file; by default report.html in SESSION.")
    ] = None,
    measure: Annotated[
        bool,
        typer.Option("--measure", help="Embed the joint covariance: two walls chosen in the page are measured."),
    ] = False,
    overwrite: OverwriteOption = False,
) -> None:
    """Write the report page of a session: map, path, loop closures, times, errors and warnings.

    Every run writes it; this command is for output directories of older versions. The page needs no network.

    Example: [bold]wclm report results/intel --overwrite[/bold]
    """
    from ...io.output_dir import REPORT
    from ...io.run_results import read_run_results
    from ...io.unfinished_file import unfinished_file
    from ...visualisation.report_page import write_page

    read = read_run_results(session)
    wall_map = _read_walls(session) if measure else None
    target = out or session / REPORT
    with unfinished_file(target, overwrite) as unfinished:
        write_page(unfinished, read, wall_map)
    typer.echo(f"{target}")


def _read_walls(session: Path) -> WallMap:
    from ...io.wall_maps import read_wall_map
    from ..setup_from_options import READING_SESSION

    with print_if_slow(READING_SESSION):
        return read_wall_map(session)
