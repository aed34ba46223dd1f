"""`wclm bench paper`: the claims of the WCLM paper."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from ...output_files import make_directory, write_text
from .output import JsonFileOption, TablesOption, heading, provenance


def bench_paper(
    as_json: JsonFileOption = None,
    out: TablesOption = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the sensor noise.")] = 0,
) -> None:
    """Reproduce the four tables and Figure 5 of the WCLM paper and check its claims.

    The two environments of the paper are simulated, with the sensor noise that it states. The same seed gives the same
    figures, except for times. Takes half a minute.

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
        write_text(as_json, json.dumps(content, indent=1))
    if out is not None:
        from ....visualisation.plots.paper_benchmark import plot_paper

        write_text(out / "tables.txt", "\n".join(text))
        plot_paper(out, measured, times)
