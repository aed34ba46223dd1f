"""`wclm bench lookalike`: loop closure and relocalisation in worlds whose places look alike."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from ...compilation import compile_all
from ...console import print_message, progress
from .output import FirstSeedOption, JsonOption, check_conditions

if TYPE_CHECKING:
    from ....evaluation.benchmarks.lookalike import LookalikeRun, LoopStatistics

EXIT_WRONG_MAP = 1
"""Exit status if a wrong loop closure was accepted or the robot was relocalised in a wrong place."""
NAMES = (
    "large_loop, equal_doors, equal_offices, square, symmetric_room, bare_corridor, mirrored_wing, moved_furniture; "
    "variants: standard, mirrored, half-circle, sparse"
)


def bench_lookalike(
    conditions: Annotated[
        list[str] | None,
        typer.Option(
            "--condition",
            metavar="NAME",
            help=f"World, or variant in which the worlds are driven; can be repeated. Worlds, by default all: {NAMES}.",
        ),
    ] = None,
    first_seed: FirstSeedOption = 0,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Number of drives per world and variant.")] = 20,
    processes: Annotated[int, typer.Option("--processes", min=1, help="Number of processes.")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Measure false loop closures and relocalisations in simulated worlds whose places look alike.

    Exit status 1 if a wrong loop closure was accepted or a lost robot was relocalised in a wrong place. A closure is
    wrong, too, if the final map is wrong where it was closed, by more than 0.5 m or 10 degrees. The column
    "wrong per drive" is the upper 95 % confidence limit of the share of drives with a wrong closure; "ended off" counts
    drives whose final position is more than 1 m off, for example because of drift.

    Example: [bold]wclm bench lookalike --condition square --condition sparse --seeds 5[/bold]
    """
    from ....evaluation.benchmarks.lookalike import VARIANTS, WORLDS, choose, run_worlds, summarise, summarise_worlds
    from ....io.host import versions
    from ....io.json_files import to_json_types

    worlds, variants = choose(check_conditions(conditions, (*WORLDS, *VARIANTS)) if conditions else ())
    compile_all()
    numbers = range(first_seed, first_seed + seeds)
    count = len(worlds) * len(variants) * seeds
    runs = list(progress(run_worlds(worlds, numbers, processes, variants), count, "look-alike worlds"))
    rows, total = summarise_worlds(runs), summarise("total", runs)
    if as_json:
        content = {"versions": versions(), "first_seed": first_seed, "seeds": seeds}
        content |= {"conditions": [asdict(row) for row in rows], "total": asdict(total)}
        typer.echo(json.dumps(to_json_types(content)))
    else:
        known = ", ".join(f"{name} {version}" for name, version in versions().items())
        typer.echo(f"seeds {numbers[0]} to {numbers[-1]}; {known}")
        _print_lookalikes([*rows, total])
    _report_wrong(runs)


def _report_wrong(runs: Sequence[LookalikeRun]) -> None:
    """Name the drives with wrong closures or relocalisations on stderr, and exit with EXIT_WRONG_MAP if there are."""
    if wrong := [run for run in runs if run.wrong]:
        print_message("wrong loop closures in " + ", ".join(f"{run.condition} seed {run.seed}" for run in wrong))
    if misplaced := [run for run in runs if run.misplaced]:
        print_message("wrong relocalisations in " + ", ".join(f"{run.condition} seed {run.seed}" for run in misplaced))
    if wrong or misplaced:
        raise typer.Exit(EXIT_WRONG_MAP)


def _print_lookalikes(rows: Sequence[LoopStatistics]) -> None:
    loops = "drift m  proposed  rejected  accepted  wrong  wrong per drive  found/needed  unambiguous  doubled"
    typer.echo(f"{'world':<28} drives  {loops}  ATE m  relocated  misplaced  ended off  failed")
    for row in rows:
        unambiguous = f"{row.unambiguous_found}/{row.unambiguous}"
        typer.echo(
            f"{row.condition:<28} {row.drives:6d} {row.drift:8.2f} {row.proposed:9d} {row.rejected:9d} "
            f"{row.accepted:9d} {row.wrong:6d} {f'< {row.wrong_limit:.3f}':>16} "
            f"{f'{row.found}/{row.needed}':>13} {unambiguous:>12} {row.doubled:8d} {row.ate:6.2f} "
            f"{row.relocated:10d} {row.misplaced:10d} {row.ended_off:10d} {row.failed:7d}"
        )
    for row in rows:
        reasons = ", ".join(f"{count} x {reason}" for reason, count in row.reasons.items())
        typer.echo(f"{row.condition}: {f'rejected because {reasons}' if reasons else 'nothing rejected'}")
