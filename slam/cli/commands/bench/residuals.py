"""`wclm bench residuals`: the noise model of walls, tested on recordings."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from ...compilation import compile_all
from ...console import progress
from .output import JsonOption, provenance
from .timing import resolve_timing


def bench_residuals(
    recordings: Annotated[list[str], typer.Argument(metavar="RECORDING", help="Recordings, as for `wclm run`.")],
    as_json: JsonOption = False,
) -> None:
    """Test the noise model of walls on recordings: residuals of observations, and maps of two halves of a drive.

    Prints the RMS of the whitened residuals of walls, which should be 1, and 1 + 2 sum of their autocorrelation up to
    15 observations of a wall: the factor by which the variances of estimates are too small. The two halves of the
    drive are also mapped separately: the NEES of the walls that are in both maps should be 1.

    Example: [bold]wclm bench residuals intel.clf[/bold]
    """
    import drivers

    from ....evaluation.benchmarks.residuals import examine, residual_table
    from ....io.json_files import to_json_types

    compile_all()
    results = []
    for recording in progress(recordings, len(recordings), "recordings"):
        source = drivers.open(recording)
        config = resolve_timing(source)
        results.append(examine(recording, list(source), config))
    if as_json:
        data = [result.as_data() for result in results]
        typer.echo(json.dumps(to_json_types(provenance(None) | {"recordings": data})))
    else:
        typer.echo("\n".join(residual_table(results)))
