"""`wclm bench relocalisation`: precision and recall of relocalisation on a recording."""

from __future__ import annotations

from typing import Annotated

import typer


def bench_relocalisation(
    recording: Annotated[
        str, typer.Argument(metavar="RECORDING", help="Recording, split into two halves of equal duration.")
    ],
    elsewhere: Annotated[
        str | None,
        typer.Option(
            "--elsewhere",
            metavar="RECORDING",
            help="Recording of another building; its map is searched instead, so every match is wrong.",
        ),
    ] = None,
    count: Annotated[int, typer.Option("--count", min=1, help="Number of queries per submap length.")] = 200,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the choice of queries.")] = 0,
) -> None:
    """Relocalise scans of a recording's second half in the map of its first half.

    Each query is a submap of the last 2, 4 or 6 metres before a random scan of the second half. The reference is the
    pose from mapping the whole recording, relative to the nearest keyframe of the first half. An accepted pose is wrong
    if it differs by more than 0.5 m or 10 degrees. Recall counts queries with such a keyframe within 2 m.

    Example: [bold]wclm bench relocalisation intel.clf[/bold]
    """
    import drivers

    from ....config import Config
    from ....evaluation.benchmarks.relocalisation import (
        SUBMAP_LENGTHS,
        known_map_of,
        run_queries,
        split_halves,
        split_recording,
        summarise_queries,
    )

    config = Config()
    messages = list(drivers.open(recording))
    other = None if elsewhere is None else known_map_of(split_halves(list(drivers.open(elsewhere)))[0], config)
    split = split_recording(messages, config)
    typer.echo("metres  places  accepted  right  precision  known  found  recall  median s  95 % s")
    for length in SUBMAP_LENGTHS:
        row = summarise_queries(length, run_queries(split, length, count, config, elsewhere=other, seed=seed))
        precision = f"{row.correct / row.accepted:.3f}" if row.accepted else "-"
        recall = f"{row.found / row.known:.3f}" if row.known else "-"
        typer.echo(
            f"{row.submap_length:6.0f}  {row.queries:6d}  {row.accepted:8d}  {row.correct:5d}  {precision:>9}  "
            f"{row.known:5d}  {row.found:5d}  {recall:>6}  {row.median:8.3f}  {row.p95:6.3f}"
        )
