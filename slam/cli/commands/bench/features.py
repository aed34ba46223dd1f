"""`wclm bench features`: how well and how fast lines and corners are found."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ...console import print_if_slow
from . import bench
from .output import heading, make_directory, plain, provenance, write

QUICK_SCANS = 20


@bench.command("features")
def bench_features(
    as_json: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write all figures as JSON.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Write tables and pictures into this directory.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the rooms and of the noise.")] = 0,
    quick: Annotated[bool, typer.Option("--quick", help="A twentieth of the scans, and no new compilation.")] = False,
) -> None:
    """Find walls and corners in simulated rooms, by every segmentation and estimator, and compare with the truth.

    Over levels of noise and of outliers: precision, recall, errors, and errors against covariances; what becomes of
    curved walls; times by the number of beams; what compilation costs. But for times, the same seed gives the same
    figures. Takes a minute or two.

    Example: [bold]wclm bench features --quick[/bold]
    """
    from features import warm_up
    from features.benchmark.accuracy import CURVED_LEVELS, SCANS, WAYS, measure
    from features.benchmark.start import measure_starts
    from features.benchmark.timing import relative, run

    from ....evaluation.benchmarks.features import accuracy_table, curved_table, start_table, time_table
    from ...slam_run import COMPILING

    if out is not None:
        make_directory(out)
    with print_if_slow(COMPILING):
        warm_up()
    scans = QUICK_SCANS if quick else SCANS
    straight = list(measure(scans=scans, seed=seed))
    curved = list(measure(scans=scans, seed=seed, levels=CURVED_LEVELS, ways=WAYS[:1], curved=True))
    times = run(scans=10, rounds=5) if quick else run()
    ratio = relative(rounds=20 if quick else 100)
    starts = [] if quick else measure_starts()
    text = [*heading(seed), f"{scans} scans of each level", *accuracy_table(straight), *curved_table(curved)]
    text += [*time_table(times, ratio), *(start_table(starts) if starts else ())]
    typer.echo("\n".join(text))
    if as_json is not None:
        content = provenance(seed) | {
            "scans": scans,
            "rooms": plain(straight),
            "curved rooms": plain(curved),
            "times": plain(times),
            "time by reference": ratio[0],
            "starts": plain(starts),
        }
        write(as_json, json.dumps(content, indent=1))
    if out is not None:
        from ....visualisation.plots.features import plot_features

        write(out / "tables.txt", "\n".join(text))
        plot_features(out / "features.png", straight, curved)
