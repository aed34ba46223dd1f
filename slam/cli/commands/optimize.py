"""`wclm optimize`: refinement of a session or recording, or optimisation of a pose graph."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..options import ConfigOption, OutOption, OverwriteOption, ReviewOption, SetOption, check_plots_extra

POSE_GRAPHS = (".g2o", ".graph", ".toro")
"""Suffixes of pose graphs: g2o, and two for TORO."""


def optimize(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SESSION|RECORDING|GRAPH",
            help="Output directory of `wclm run`, recording, or 2-D pose graph (.g2o; TORO: .graph, .toro).",
        ),
    ],
    out: OutOption,
    overwrite: OverwriteOption = False,
    robust: Annotated[
        bool,
        typer.Option(
            "--robust",
            help="Pose graph: reject edges that contradict the others, except those between consecutive poses.",
        ),
    ] = False,
    config: ConfigOption = None,
    settings: SetOption = None,
    review: ReviewOption = True,
    plot: Annotated[
        bool,
        typer.Option(
            "--plot",
            callback=check_plots_extra,
            help="Write a picture of the map, or of the graph before and after.",
        ),
    ] = False,
) -> None:
    """Refine a session or a recording offline, or optimise a 2-D pose graph.

    Refinement repeats data association and batch optimisation until the result no longer changes, and writes another
    session. A pose graph is written as graph.g2o. --config and --set apply to recordings only: a session has
    its own settings.

    Example: [bold]wclm optimize results/intel --out results/intel-optimised[/bold]
    """
    from ...io.output_dir import MAP
    from ...io.sessions import is_session

    path = Path(source)
    if path.suffix.lower() in POSE_GRAPHS:
        from .optimize_graph import optimize_graph

        _refuse_settings(config, settings, "a pose graph has no settings")
        typer.echo("\n".join(optimize_graph(path, out, overwrite=overwrite, robust=robust, picture=plot)))
        return
    from .optimize_session import optimize_recording, optimize_session

    if robust:
        raise typer.BadParameter("is for pose graphs", param_hint="--robust")
    if is_session(path) or (path / MAP).is_file():
        _refuse_settings(config, settings, "a session has its own settings")
        lines = optimize_session(path, out, overwrite=overwrite, review=review, picture=plot)
    else:
        from ...config import load_config

        effective = load_config(config, settings or ())
        lines = optimize_recording(source, effective, out, overwrite=overwrite, review=review, picture=plot)
    typer.echo("\n".join(lines))


def _refuse_settings(config: Path | None, settings: list[str] | None, reason: str) -> None:
    """Raise BadParameter if settings are stated that would have no effect."""
    if config is not None or settings:
        raise typer.BadParameter(reason, param_hint="--config / --set")
