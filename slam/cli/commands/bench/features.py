"""`wclm bench features`: accuracy and speed of line and corner extraction."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from ...compilation import COMPILING
from ...console import print_if_slow
from ...output_files import make_directory, write_text
from .output import JsonFileOption, TablesOption, heading, plain_rows, provenance

QUICK_SCANS = 20


def bench_features(
    as_json: JsonFileOption = None,
    out: TablesOption = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the rooms and of the sensor noise.")] = 0,
    quick: Annotated[
        bool, typer.Option("--quick", help="Use a twentieth of the scans and do not measure compilation.")
    ] = False,
) -> None:
    """Measure line and corner extraction on simulated rooms, for every segmentation and estimator.

    Reports precision, recall, errors and NEES for several levels of noise and outliers, the result on curved walls,
    times by number of beams, and compilation times. The same seed gives the same figures, except for times. Takes one
    to two minutes.

    Example: [bold]wclm bench features --quick[/bold]
    """
    from features import warm_up
    from features.benchmark.accuracy import CURVED_LEVELS, METHODS, SCANS, measure
    from features.benchmark.start import measure_starts
    from features.benchmark.timing import relative, run

    from ....evaluation.benchmarks.feature_tables import accuracy_table, curved_table, start_table, time_table

    if out is not None:
        make_directory(out)
    with print_if_slow(COMPILING):
        warm_up()
    scans = QUICK_SCANS if quick else SCANS
    straight = list(measure(scans=scans, seed=seed))
    curved = list(measure(scans=scans, seed=seed, levels=CURVED_LEVELS, methods=METHODS[:1], curved=True))
    times = run(scans=10, rounds=5) if quick else run()
    ratio = relative(rounds=200) if quick else relative()
    starts = [] if quick else measure_starts()
    text = [*heading(seed), f"{scans} scans per level", *accuracy_table(straight), *curved_table(curved)]
    text += [*time_table(times, ratio), *(start_table(starts) if starts else ())]
    typer.echo("\n".join(text))
    if as_json is not None:
        content = provenance(seed) | {
            "scans": scans,
            "rooms": plain_rows(straight),
            "curved rooms": plain_rows(curved),
            "times": plain_rows(times),
            "time by reference": ratio[0],
            "starts": plain_rows(starts),
        }
        write_text(as_json, json.dumps(content, indent=1))
    if out is not None:
        from ....visualisation.plots.feature_benchmark import plot_features

        write_text(out / "tables.txt", "\n".join(text))
        plot_features(out / "features.png", straight, curved)
