"""`wclm recover`: completing the results of a killed run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def recover(
    out: Annotated[Path, typer.Argument(metavar="DIR", help="Output directory of the run that was killed.")],
) -> None:
    """Complete the results of a run that was killed, or ended by a power failure.

    DIR contains the map that the live run saved last, at most a minute before its end. The review log, left in a
    hidden directory beside it, is moved into DIR, and the report page is written. Nothing is deleted.

    Example: [bold]wclm recover map[/bold]
    """
    from ...errors import SlamError
    from ...io.output_dir import REPORT, SUMMARY
    from ...io.recovery import recover_results
    from ...visualisation.report_page import write_report_page
    from ..console import print_message

    lines = recover_results(out)
    if (out / SUMMARY).is_file() and not (out / REPORT).exists():
        try:
            write_report_page(out)
            lines.append(f"{out}: {REPORT}")
        except SlamError as error:
            print_message(f"no report page: {error}")
    typer.echo("\n".join(lines))
