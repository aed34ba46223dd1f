"""`wclm bench slam` and `wclm bench gate`: whole drives, and whether anything fell back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ...console import print_if_slow, print_message, progress
from . import bench
from .output import heading, make_directory, provenance, write

EXIT_REGRESSION = 1
"""Exit status where something is worse than it was: the figures are right, the program is not."""
DATASETS = "WCLM_DATASETS"


@bench.command("slam")
def bench_slam(
    datasets: Annotated[
        Path | None, typer.Option("--datasets", envvar=DATASETS, help="Folder with NAME/NAME.clf and its relations.")
    ] = None,
    as_json: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write all figures as JSON.")] = None,
    versions: Annotated[
        Path | None, typer.Option("--versions", metavar="DIR", help="JSON files of released versions, to plot beside.")
    ] = None,
    plot: Annotated[Path | None, typer.Option("--plot", metavar="FILE.png", help="Draw them over versions.")] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of simulated drives.")] = 0,
    quick: Annotated[bool, typer.Option("--quick", help="Twenty seconds of two simulated drives.")] = False,
) -> None:
    """Map whole drives: accuracy, time, memory, size of the map, closures.

    The recordings of the SLAM benchmark where they are, and simulated worlds; one after the other, each in a process
    of its own. Takes two minutes, or five with the recordings.

    Example: [bold]wclm bench slam --datasets datasets --json 0.1.0.json[/bold]
    """
    from ....evaluation.benchmarks.drives import as_data, cases, rows, run
    from ....warmup import warm_up
    from ...slam_run import COMPILING

    with print_if_slow(COMPILING):
        warm_up()
    chosen = cases(datasets, quick=quick, seed=seed)
    results = list(progress(run(chosen), len(chosen), "drives"))
    typer.echo("\n".join([*heading(seed), *rows(results)]))
    content = provenance(seed) | {"drives": as_data(results)}
    if as_json is not None:
        make_directory(as_json.parent)
        write(as_json, json.dumps(content, indent=1))
    if plot is not None:
        from ....evaluation.benchmarks.versions import read_versions
        from ....visualisation.plots.versions import plot_versions

        known = read_versions(versions) if versions is not None else {}
        plot_versions(plot, known | {content["versions"]["wclm-slam"]: content["drives"]})


@bench.command("gate")
def bench_gate() -> None:
    """Run a small slice of the benchmarks; exit status 1 where accuracy or time has fallen back.

    Example: [bold]wclm bench gate[/bold]
    """
    from ....evaluation.benchmarks.gate import checks, lines
    from ....warmup import warm_up
    from ...slam_run import COMPILING

    with print_if_slow(COMPILING):
        warm_up()
    typer.echo("\n".join(heading(0)))
    found = []
    for check in checks():
        found.append(check)
        typer.echo("\n".join(lines([check])))
    if worse := [check.name for check in found if not check.passed]:
        print_message("fell back: " + ", ".join(worse))
        raise typer.Exit(EXIT_REGRESSION)
