"""`wclm bench`: measurements side by side."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .console import complain, progress, say_if_slow

if TYPE_CHECKING:
    from ..benchmarks.lookalike import Row

WRONG_ACCEPTED = 1
"""Exit status where a wrong closure was accepted: the figures are right, the map is not."""

JsonOption = Annotated[bool, typer.Option("--json", help="Print one line of JSON.")]

bench = typer.Typer(no_args_is_help=True, help="Measure how fast, how accurate and how wary parts are.")


@bench.command("features")
def bench_features() -> None:
    """Time the ways to find lines in a scan, by the number of beams, on one core.

    Example: [bold]wclm bench features[/bold]
    """
    from features.benchmark import run

    typer.echo("method/estimator      beams  lines  median us   99 % us")
    for row in run():
        typer.echo(f"{row.name:<21} {row.beams:5d} {row.lines:6.1f} {row.median_us:10.1f} {row.p99_us:9.1f}")


@bench.command("lookalike")
def bench_lookalike(
    worlds: Annotated[
        str | None, typer.Option("--worlds", metavar="A,B", help="Some of the worlds; all where left out.")
    ] = None,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Drives through each world, with seeds from 0.")] = 20,
    processes: Annotated[int, typer.Option("--processes", min=1, help="Drives at a time.")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Drive through worlds whose places look alike; exit status 1 if a wrong loop closure was accepted.

    Example: [bold]wclm bench lookalike --seeds 5[/bold]
    """
    from ..benchmarks.lookalike import WORLDS, condense, run
    from ..warmup import warm_up
    from .report import versions
    from .session import COMPILING

    chosen = WORLDS if worlds is None else tuple(worlds.split(","))
    if unknown := [world for world in chosen if world not in WORLDS]:
        raise typer.BadParameter(f"{unknown[0]}: there are {', '.join(WORLDS)}", param_hint="--worlds")
    with say_if_slow(COMPILING):
        warm_up()
    drives = list(progress(run(chosen, range(seeds), processes), len(chosen) * seeds, "look-alike worlds"))
    rows = condense(drives)
    if as_json:
        typer.echo(json.dumps({"versions": versions(), "seeds": seeds, "worlds": [asdict(row) for row in rows]}))
    else:
        typer.echo(f"seeds 0 to {seeds - 1}; " + ", ".join(f"{name} {version}" for name, version in versions().items()))
        _print_lookalikes(rows)
    if wrong := [drive for drive in drives if drive.wrong]:
        complain("wrong closures in " + ", ".join(f"{drive.world} seed {drive.seed}" for drive in wrong))
        raise typer.Exit(WRONG_ACCEPTED)


def _print_lookalikes(rows: list[Row]) -> None:
    columns = "drift m  proposed  rejected  held  accepted  wrong  found/needed  doubled  ATE m  failed"
    typer.echo(f"{'world':<15} drives  {columns}")
    for row in rows:
        typer.echo(
            f"{row.world:<15} {row.drives:6d} {row.drift:8.2f} {row.proposed:9d} {row.rejected:9d} {row.held:5d} "
            f"{row.accepted:9d} {row.wrong:6d} {f'{row.found}/{row.needed}':>13} {row.doubled:8d} {row.ate:6.2f} "
            f"{row.failed:7d}"
        )
    for row in rows:
        reasons = ", ".join(f"{count} x {reason}" for reason, count in row.reasons.items())
        typer.echo(f"{row.world}: {f'rejected because {reasons}' if reasons else 'nothing rejected'}")


@bench.command("false-closures")
def bench_false_closures(
    recording: Annotated[str, typer.Argument(help="A recording with relations.")],
    relations: Annotated[Path, typer.Option("--relations", help="True motions (Kuemmerle et al. 2009).")],
    count: Annotated[int, typer.Option("--count", min=1, help="False candidates.")] = 50,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of when and where they are.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Force false candidates into the proposals for loops, and compare with the result without them.

    Example: [bold]wclm bench false-closures intel.clf --relations intel.relations[/bold]
    """
    from ..benchmarks.false_closures import run
    from ..warmup import warm_up
    from .report import versions
    from .session import COMPILING

    with say_if_slow(COMPILING):
        warm_up()
    outcome = run(recording, relations, count, seed)
    if as_json:
        typer.echo(json.dumps({"versions": versions(), "seed": seed, **asdict(outcome)}))
        return
    typer.echo(
        f"candidates   {outcome.forced} false ones at {outcome.looks} looks (seed {seed}), {outcome.taken} taken\n"
        f"closures     {outcome.accepted_clean} without them, {outcome.accepted} with them\n"
        f"translation  {outcome.translation_clean:.4f} m without them, {outcome.translation:.4f} m with them\n"
        f"rotation     {outcome.rotation_clean:.3f} degrees without them, {outcome.rotation:.3f} with them"
    )
