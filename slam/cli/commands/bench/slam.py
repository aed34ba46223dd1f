"""`wclm bench slam`: accuracy, time and memory on whole drives."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ...compilation import compile_all
from ...console import progress
from ...output_files import make_directory, write_text
from .output import JsonFileOption, heading, provenance


def bench_slam(
    datasets: Annotated[
        Path | None,
        typer.Option(
            "--datasets",
            envvar="WCLM_DATASETS",
            exists=True,
            file_okay=False,
            help="Directory with NAME/NAME.clf and its relations.",
        ),
    ] = None,
    as_json: JsonFileOption = None,
    versions: Annotated[
        Path | None,
        typer.Option(
            "--versions",
            metavar="DIR",
            exists=True,
            file_okay=False,
            help="Directory with the JSON files of earlier versions, for the plot.",
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE.png", help="Picture of the figures by version.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the simulated drives.")] = 0,
    quick: Annotated[bool, typer.Option("--quick", help="Use only twenty seconds of two simulated drives.")] = False,
) -> None:
    """Map whole drives and report accuracy, time, memory, map size and loop closures.

    Maps simulated worlds, and the recordings of the SLAM benchmark found in --datasets, each in its own process. Takes
    two minutes, or five with the recordings.

    Example: [bold]wclm bench slam --datasets datasets --json 0.1.0.json[/bold]
    """
    from ....evaluation.benchmarks.slam_runs import list_runs, result_table, results_as_data, run_all

    compile_all()
    chosen = list_runs(datasets, quick=quick, seed=seed)
    results = list(progress(run_all(chosen), len(chosen), "drives"))
    typer.echo("\n".join([*heading(seed), *result_table(results)]))
    content = provenance(seed) | {"drives": results_as_data(results)}
    if as_json is not None:
        make_directory(as_json.parent)
        write_text(as_json, json.dumps(content, indent=1))
    if plot is not None:
        from ....evaluation.benchmarks.released_versions import read_versions
        from ....visualisation.plots.version_history import plot_versions

        known = read_versions(versions) if versions is not None else {}
        plot_versions(plot, known | {content["versions"]["wclm-slam"]: content["drives"]})
