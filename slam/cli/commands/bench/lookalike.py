"""`wclm bench lookalike`: loop closure and relocalisation in worlds whose places look alike."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from ...compilation import compile_all
from ...console import print_message, progress
from .output import JsonOption

if TYPE_CHECKING:
    from ....evaluation.benchmarks.lookalike import WorldStatistics

EXIT_WRONG_MAP = 1
"""Exit status if a wrong loop closure was accepted or the robot was relocalised in a wrong place."""


def bench_lookalike(
    worlds: Annotated[
        str | None, typer.Option("--worlds", metavar="A,B", help="Worlds, by name; by default all.")
    ] = None,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Number of drives per world, with seeds from 0.")] = 20,
    processes: Annotated[int, typer.Option("--processes", min=1, help="Number of processes.")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Measure false loop closures and relocalisations in simulated worlds whose places look alike.

    Exit status 1 if a wrong loop closure was accepted or a lost robot was relocalised in a wrong place. The column
    "ended off" counts drives whose final position is more than 1 m off, for example because of drift.

    Example: [bold]wclm bench lookalike --seeds 5[/bold]
    """
    from ....evaluation.benchmarks.lookalike import WORLDS, run_worlds, summarise_worlds
    from ....io.host import versions

    chosen = WORLDS if worlds is None else tuple(worlds.split(","))
    if unknown := [world for world in chosen if world not in WORLDS]:
        raise typer.BadParameter(f"{unknown[0]}: no such world; known are {', '.join(WORLDS)}", param_hint="--worlds")
    compile_all()
    runs = list(progress(run_worlds(chosen, range(seeds), processes), len(chosen) * seeds, "look-alike worlds"))
    rows = summarise_worlds(runs)
    if as_json:
        typer.echo(json.dumps({"versions": versions(), "seeds": seeds, "worlds": [asdict(row) for row in rows]}))
    else:
        typer.echo(f"seeds 0 to {seeds - 1}; " + ", ".join(f"{name} {version}" for name, version in versions().items()))
        _print_lookalikes(rows)
    if wrong := [run for run in runs if run.wrong]:
        print_message("wrong loop closures in " + ", ".join(f"{run.world} seed {run.seed}" for run in wrong))
    if misplaced := [run for run in runs if run.misplaced]:
        print_message("wrong relocalisations in " + ", ".join(f"{run.world} seed {run.seed}" for run in misplaced))
    if wrong or misplaced:
        raise typer.Exit(EXIT_WRONG_MAP)


def _print_lookalikes(rows: list[WorldStatistics]) -> None:
    loops = "drift m  proposed  rejected  pending  accepted  wrong  found/needed  doubled  ATE m"
    typer.echo(f"{'world':<15} drives  {loops}  relocated  misplaced  ended off  failed")
    for row in rows:
        typer.echo(
            f"{row.world:<15} {row.drives:6d} {row.drift:8.2f} {row.proposed:9d} {row.rejected:9d} {row.pending:8d} "
            f"{row.accepted:9d} {row.wrong:6d} {f'{row.found}/{row.needed}':>13} {row.doubled:8d} {row.ate:6.2f} "
            f"{row.relocated:10d} {row.misplaced:10d} {row.ended_off:10d} {row.failed:7d}"
        )
    for row in rows:
        reasons = ", ".join(f"{count} x {reason}" for reason, count in row.reasons.items())
        typer.echo(f"{row.world}: {f'rejected because {reasons}' if reasons else 'nothing rejected'}")
