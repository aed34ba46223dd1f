"""`wclm bench`: measurements side by side."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ...console import progress
from .output import heading, make_directory, provenance, write

bench = typer.Typer(no_args_is_help=True, help="Measure how fast, how accurate and how wary parts are.")


@bench.command("consistency")
def bench_consistency(
    runs: Annotated[int, typer.Option("--runs", min=1, help="Simulated drives, each with other noise.")] = 100,
    duration: Annotated[float, typer.Option("--duration", help="Seconds of each.")] = 60.0,
    range_bias: Annotated[
        float, typer.Option("--range-bias", min=-0.5, max=0.5, help="Metres by which all ranges come out long.")
    ] = 0.0,
    calibrate: Annotated[
        bool, typer.Option("--calibrate", help="Estimate that from one more drive, as `wclm calibrate` does.")
    ] = False,
) -> None:
    """Compare errors with covariances, over simulated drives where the truth is known; two seconds a drive.

    The lidar is mounted off-centre and turned by 100 degrees. 1 is perfect, more is overconfident.

    Example: [bold]wclm bench consistency --runs 20[/bold]
    """
    from ....config import Config
    from ....evaluation.benchmarks.consistency import calibrated, simulate, summarise, table

    config = Config()
    typer.echo("\n".join(heading(0)))
    if calibrate:
        config, sigma = calibrated(range_bias, duration)
        typer.echo(f"ranges are taken to be {config.lidar.range_bias:.4f} ± {sigma:.4f} m too long")
    drives = simulate(range(runs), duration, range_bias=range_bias, config=config)
    found = list(progress(drives, runs, "drives"))
    typer.echo("\n".join(table(summarise(found))))


@bench.command("laps")
def bench_laps(
    world: Annotated[str, typer.Argument(help="A simulated world.")] = "office",
    laps: Annotated[int, typer.Option("--laps", min=1, help="Rounds of its path.")] = 10,
    seed: Annotated[int, typer.Option("--seed", help="Of the noise.")] = 0,
) -> None:
    """Drive the same tour again and again: time a scan and memory must stay as they are.

    Example: [bold]wclm bench laps office --laps 10[/bold]
    """
    from ....config import Config
    from ....evaluation.benchmarks.laps import run

    typer.echo("lap  median ms  99 % ms  memory MB  keyframes  factors  walls")
    for lap in run(world, laps, Config(), seed=seed):
        sizes = f"{lap.keyframes:9d}  {lap.factors:7d}  {lap.walls:5d}"
        typer.echo(f"{lap.number:3d}  {lap.median:9.2f}  {lap.p99:7.2f}  {lap.memory:9.0f}  {sizes}")


@bench.command("paper")
def bench_paper(
    as_json: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write all figures as JSON.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Write tables and pictures into this directory.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the simulated noise.")] = 0,
) -> None:
    """Test what the WCLM paper claims: its four tables and Figure 5, its numbers beside ours, and what holds.

    Its two environments are simulated, with the sensor's stated noise. But for times, the same seed gives the same
    figures. Takes half a minute.

    Example: [bold]wclm bench paper --json paper.json --out pictures[/bold]
    """
    from ....evaluation.benchmarks.paper.claims import judge
    from ....evaluation.benchmarks.paper.run import measure, measure_times
    from ....evaluation.benchmarks.paper.tables import lines

    if out is not None:
        make_directory(out)
    measured, times = measure(seed), measure_times()
    claims = judge(measured, times)
    text = [*heading(seed), *lines(measured, times, claims)]
    typer.echo("\n".join(text))
    if as_json is not None:
        content = provenance(seed) | {
            "claims": [claim._asdict() for claim in claims],
            "measured": measured,
            "times": times,
        }
        write(as_json, json.dumps(content, indent=1))
    if out is not None:
        from ....visualisation.plots.paper import plot_paper

        write(out / "tables.txt", "\n".join(text))
        plot_paper(out, measured, times)
