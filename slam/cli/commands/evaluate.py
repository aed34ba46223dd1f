"""`wclm eval`: accuracy of a trajectory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ..console import print_message

EXIT_INCOMPLETE = 1
"""Exit status if relations lie outside the trajectory's time: the figures are not those of the whole benchmark."""


def evaluate(
    trajectory: Annotated[Path, typer.Argument(help="Trajectory in TUM format: t x y z qx qy qz qw per line.")],
    relations: Annotated[
        Path | None, typer.Option("--relations", help="Relations: true motions between poses (Kuemmerle et al. 2009).")
    ] = None,
    reference: Annotated[
        Path | None, typer.Option("--reference", help="Reference trajectory in the same format.")
    ] = None,
    plot: Annotated[Path | None, typer.Option("--plot", metavar="FILE.png", help="Picture of the errors.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one line of JSON instead of text.")] = False,
) -> None:
    """Score a trajectory against relations or a reference trajectory.

    Exit status 1 if some relations lie outside the trajectory's time.

    Example: [bold]wclm eval out/trajectory.tum --relations intel.relations[/bold]
    """
    if (relations is None) == (reference is None):
        raise typer.BadParameter("exactly one of the two is required", param_hint="--relations / --reference")
    if relations is not None:
        _against_relations(trajectory, relations, plot, as_json)
    elif reference is not None:
        _against_reference(trajectory, reference, plot, as_json)


def _against_relations(trajectory: Path, relations: Path, plot: Path | None, as_json: bool) -> None:
    from ...evaluation.metrics import read_relations, score_relations
    from ...io.tum import read_tum

    score = score_relations(read_tum(trajectory), read_relations(relations))
    figures = score.figures()
    if as_json:
        typer.echo(json.dumps(figures))
    else:
        typer.echo(
            f"translation {figures['trans_mean']:.4f} +- {figures['trans_std']:.4f} m "
            f"(median {figures['trans_median']:.4f}, max {figures['trans_max']:.3f})\n"
            f"rotation    {figures['rot_mean']:.3f} +- {figures['rot_std']:.3f} degrees "
            f"(max {figures['rot_max']:.2f})\n"
            f"relations   {figures['relations']}, {100 * figures['interpolated']:.1f} % with an interpolated pose, "
            f"{figures['missing']} outside the trajectory"
        )
    if plot is not None:
        from ...visualisation.plots import plot_relations

        plot_relations(plot, score, title=f"{trajectory.name} against {relations.name}")
    if score.missing:
        print_message(f"{trajectory}: {score.missing} relations lie outside the trajectory's time and are not scored")
        raise typer.Exit(EXIT_INCOMPLETE)


def _against_reference(trajectory: Path, reference: Path, plot: Path | None, as_json: bool) -> None:
    from ...evaluation.metrics import score_reference
    from ...io.tum import read_tum

    score = score_reference(read_tum(trajectory), read_tum(reference))
    figures = score.figures()
    if as_json:
        typer.echo(json.dumps(figures))
    else:
        typer.echo(
            f"absolute  {figures['ate_rmse']:.4f} m RMSE after alignment (mean {figures['ate_mean']:.4f}, "
            f"median {figures['ate_median']:.4f}, max {figures['ate_max']:.3f}), "
            f"heading {figures['heading_rmse']:.3f} degrees RMSE"
        )
        if len(score.relative):
            typer.echo(
                f"relative  {figures['rpe_trans_rmse']:.4f} m and {figures['rpe_rot_rmse']:.3f} degrees RMSE "
                f"over {score.step:g} m"
            )
        typer.echo(f"poses     {figures['poses']} at common times")
    if plot is not None:
        from ...visualisation.plots import plot_reference

        plot_reference(plot, score, title=f"{trajectory.name} against {reference.name}")
