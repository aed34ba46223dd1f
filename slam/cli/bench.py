"""`wclm bench`: measurements side by side."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ..errors import OutputError

bench = typer.Typer(no_args_is_help=True, help="Measure how fast and how accurate parts are.")


@bench.command("features")
def bench_features() -> None:
    """Time the ways to find lines in a scan, by the number of beams, on one core.

    Example: [bold]wclm bench features[/bold]
    """
    from features.benchmark import run

    typer.echo("method/estimator      beams  lines  median us   99 % us")
    for row in run():
        typer.echo(f"{row.name:<21} {row.beams:5d} {row.lines:6.1f} {row.median_us:10.1f} {row.p99_us:9.1f}")


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

    from ..benchmarks.relocalisation import WAYS, cut, halves, index_of, run, summary
    from ..config import Config

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
    from ..benchmarks.paper.claims import judge
    from ..benchmarks.paper.run import measure, measure_times
    from ..benchmarks.paper.tables import lines
    from .report import machine, versions

    if out is not None:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{out}: cannot be made: {error.strerror or error}") from error
    measured, times = measure(seed), measure_times()
    claims = judge(measured, times)
    header = {"machine": machine(), "versions": versions()}
    text = [
        "; ".join(f"{name}: {value}" for name, value in machine().items()),
        ", ".join(f"{name} {version}" for name, version in versions().items()) + f"; seed {seed}",
        *lines(measured, times, claims),
    ]
    typer.echo("\n".join(text))
    if as_json is not None:
        content = header | {"claims": [claim._asdict() for claim in claims], "measured": measured, "times": times}
        _write(as_json, json.dumps(content, indent=1))
    if out is not None:
        from ..plots.paper import plot_paper

        _write(out / "tables.txt", "\n".join(text))
        plot_paper(out, measured, times)


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
