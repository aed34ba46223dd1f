"""`wclm bench`: how often places are recognised, and how often wrongly."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...console import print_if_slow, print_message, progress
from . import bench

if TYPE_CHECKING:
    from ....evaluation.benchmarks.lookalike import Row

EXIT_WRONG_MAP = 1
"""Exit status where a wrong closure was accepted, or the robot found in a wrong place: the figures are right, the map
is not."""

JsonOption = Annotated[bool, typer.Option("--json", help="Print one line of JSON.")]


@bench.command("relocalisation")
def bench_relocalisation(
    recording: Annotated[str, typer.Argument(help="A recording; it is cut in two halves of equal time.")],
    elsewhere: Annotated[
        str | None,
        typer.Option("--elsewhere", metavar="RECORDING", help="Search the map of another building, in vain."),
    ] = None,
    count: Annotated[int, typer.Option("--count", min=1, help="Places to look for, of each length of driving.")] = 200,
    seed: Annotated[int, typer.Option("--seed", help="Of the choice of places.")] = 0,
) -> None:
    """Look for places of a recording's second half in the map of its first half.

    A fragment is mapped of the last 2, 4 and 6 metres before random scans. An accepted pose is wrong if it is more than
    0.5 m or 10 degrees off; the pose of the uncut run, where both halves are one map, stands for the truth, carried
    over by the nearest keyframe of the first half. A place is known if such a keyframe is within 2 m.

    Example: [bold]wclm bench relocalisation intel.clf[/bold]
    """
    import drivers

    from ....config import Config
    from ....evaluation.benchmarks.relocalisation import WAYS, cut, halves, index_of, run, summary

    config = Config()
    messages = list(drivers.open(recording))
    other = None if elsewhere is None else index_of(halves(list(drivers.open(elsewhere)))[0], config)
    known = cut(messages, config)
    typer.echo("metres  places  accepted  right  precision  known  found  recall  median s  95 % s")
    for way in WAYS:
        row = summary(way, run(known, way, count, config, elsewhere=other, seed=seed))
        precision = f"{row.right / row.accepted:.3f}" if row.accepted else "-"
        recall = f"{row.found / row.known:.3f}" if row.known else "-"
        typer.echo(
            f"{row.way:6.0f}  {row.queries:6d}  {row.accepted:8d}  {row.right:5d}  {precision:>9}  {row.known:5d}  "
            f"{row.found:5d}  {recall:>6}  {row.median:8.3f}  {row.p95:6.3f}"
        )


@bench.command("lookalike")
def bench_lookalike(
    worlds: Annotated[
        str | None, typer.Option("--worlds", metavar="A,B", help="Some of the worlds; all where left out.")
    ] = None,
    seeds: Annotated[
        int, typer.Option("--seeds", min=1, help="OdometrySegments through each world, with seeds from 0.")
    ] = 20,
    processes: Annotated[int, typer.Option("--processes", min=1, help="OdometrySegments at a time.")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Drive through worlds whose places look alike; exit status 1 if the map was made wrong there.

    That is if a wrong loop closure was accepted, or if a robot that was lost was found in another place than the one
    where it was. OdometrySegments are counted besides that ended more than 1 m off: there drift is counted, too.

    Example: [bold]wclm bench lookalike --seeds 5[/bold]
    """
    from ....evaluation.benchmarks.lookalike import WORLDS, condense, run
    from ....io.host import versions
    from ....warmup import warm_up
    from ...slam_run import COMPILING

    chosen = WORLDS if worlds is None else tuple(worlds.split(","))
    if unknown := [world for world in chosen if world not in WORLDS]:
        raise typer.BadParameter(f"{unknown[0]}: there are {', '.join(WORLDS)}", param_hint="--worlds")
    with print_if_slow(COMPILING):
        warm_up()
    drives = list(progress(run(chosen, range(seeds), processes), len(chosen) * seeds, "look-alike worlds"))
    rows = condense(drives)
    if as_json:
        typer.echo(json.dumps({"versions": versions(), "seeds": seeds, "worlds": [asdict(row) for row in rows]}))
    else:
        typer.echo(f"seeds 0 to {seeds - 1}; " + ", ".join(f"{name} {version}" for name, version in versions().items()))
        _print_lookalikes(rows)
    if wrong := [drive for drive in drives if drive.wrong]:
        print_message("wrong closures in " + ", ".join(f"{drive.world} seed {drive.seed}" for drive in wrong))
    if misplaced := [drive for drive in drives if drive.misplaced]:
        print_message(
            "found in wrong places in " + ", ".join(f"{drive.world} seed {drive.seed}" for drive in misplaced)
        )
    if wrong or misplaced:
        raise typer.Exit(EXIT_WRONG_MAP)


def _print_lookalikes(rows: list[Row]) -> None:
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
    from ....evaluation.benchmarks.false_closures import run
    from ....io.host import versions
    from ....warmup import warm_up
    from ...slam_run import COMPILING

    with print_if_slow(COMPILING):
        warm_up()
    result = run(recording, relations, count, seed)
    if as_json:
        typer.echo(json.dumps({"versions": versions(), "seed": seed, **asdict(result)}))
        return
    typer.echo(
        f"candidates   {result.forced} false ones at {result.looks} looks (seed {seed}), {result.taken} taken\n"
        f"closures     {result.accepted_clean} without them, {result.accepted} with them\n"
        f"translation  {result.translation_clean:.4f} m without them, {result.translation:.4f} m with them\n"
        f"rotation     {result.rotation_clean:.3f} degrees without them, {result.rotation:.3f} with them"
    )
