"""`wclm bench false-closures`: robustness to false matches of places."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from ...compilation import compile_all
from .output import JsonOption


def bench_false_closures(
    recording: Annotated[str, typer.Argument(metavar="RECORDING", help="Recording, as for `wclm run`.")],
    relations: Annotated[
        Path,
        typer.Option(
            "--relations", help="Relations of the recording: true motions between poses (Kuemmerle et al. 2009)."
        ),
    ],
    count: Annotated[int, typer.Option("--count", min=1, help="Number of false matches.")] = 50,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the times and places of the false matches.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Inject false matches into the loop search and compare the result with that of a normal run.

    Example: [bold]wclm bench false-closures intel.clf --relations intel.relations[/bold]
    """
    from ....evaluation.benchmarks.false_closures import run_with_false_matches
    from ....io.host import versions

    compile_all()
    result = run_with_false_matches(recording, relations, count, seed)
    if as_json:
        typer.echo(json.dumps({"versions": versions(), "seed": seed, **asdict(result)}))
        return
    typer.echo(
        f"matches      {result.injected} false ones in {result.searches} searches (seed {seed}), "
        f"{result.false_accepted} accepted\n"
        f"closures     {result.accepted_clean} without them, {result.accepted} with them\n"
        f"translation  {result.translation_clean:.4f} m without them, {result.translation:.4f} m with them\n"
        f"rotation     {result.rotation_clean:.3f} degrees without them, {result.rotation:.3f} with them"
    )
