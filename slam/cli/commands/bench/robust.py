"""`wclm bench robust`: recordings and worlds that nobody tuned for, compared with raw odometry."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ...compilation import compile_all
from ...console import progress
from .output import JsonOption, check_conditions, heading, provenance
from .timing import resolve_timing


def bench_robust(
    folder: Annotated[
        Path | None,
        typer.Argument(
            envvar="WCLM_DATASETS", help="Directory with recordings, and their references beside them; optional."
        ),
    ] = None,
    conditions: Annotated[
        list[str] | None,
        typer.Option(
            "--condition",
            metavar="NAME",
            help="World, or name of a recording; can be repeated. By default all recordings and all worlds: crowd, "
            "turns, reversed-beams, late-lidar, wide-hall, columns, buildings, failing-odometry, strangers, patrol, "
            "known-map, refurnished-map, continued-map.",
        ),
    ] = None,
    variants: Annotated[
        list[str] | None,
        typer.Option(
            "--variant",
            metavar="NAME",
            help="Map the recordings in this variant instead of as they are; can be repeated: backwards, drift "
            "(errors of odometry drawn from the seed), backwards-drift, failing-odometry, failing-lidar (without scans "
            "for 5 to 40 s, again and again), carried (switched off meanwhile, and odometry starts anew), jitter "
            "(noise of 1 micrometre), narrow (90 degrees of the field of view), short-range (readings of up to 5 m), "
            "thinned.",
        ),
    ] = None,
    first_seed: Annotated[int, typer.Option("--first-seed", min=0, help="Seed of the first drive of a world.")] = 0,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Number of drives per world.")] = 2,
    processes: Annotated[int, typer.Option("--processes", min=1, help="Number of processes.")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Map recordings and simulated worlds that nobody tuned for, and compare the results with raw odometry.

    Maps all recordings in a directory and its subdirectories. A reference is a file beside the recording:
    NAME.relations, or a trajectory such as NAME.gmapping.tum. Prints for each drive the error, the entropy of the map
    and the share of conflicting hits (for SLAM / for raw odometry; bold if SLAM is worse), the share of scans with a
    pose, the share of scans while LOST, the number of suspects, and the processor time.

    Example: [bold]wclm bench robust datasets --condition intel --condition crowd[/bold]
    """
    from ....evaluation.benchmarks.robust import run_jobs, select_jobs
    from ....evaluation.benchmarks.robust_drives import VARIANTS, WORLDS, find_recordings
    from ....evaluation.benchmarks.robust_table import TABLE_HEAD, table_row
    from ....io.json_files import to_json_types

    recordings = [] if folder is None else find_recordings(folder)
    changes = check_conditions(variants, VARIANTS, "variant") if variants else ()
    worlds = () if changes else WORLDS
    chosen = check_conditions(conditions, (*(drive.name for drive in recordings), *worlds))
    compile_all()
    jobs = select_jobs(recordings, chosen, range(first_seed, first_seed + seeds), changes)
    drives = progress(run_jobs(jobs, resolve_timing, processes), len(jobs), "drives")
    if as_json:
        results = list(drives)
        content = provenance(first_seed) | {"seeds": seeds, "drives": [result.as_data() for result in results]}
        content["worse_than_odometry"] = sum(bool(result.worse) for result in results)
        content["failed"] = sum(bool(result.failed) for result in results)
        typer.echo(json.dumps(to_json_types(content)))
    else:
        typer.echo("\n".join([*heading(first_seed), "", *TABLE_HEAD]))
        for result in drives:
            typer.echo(table_row(result))
