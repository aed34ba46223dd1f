"""`wclm eval`: accuracy of a trajectory."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...io.output_dir import TRAJECTORY
from ..console import print_message
from ..options import check_picture

if TYPE_CHECKING:
    from ...evaluation.metrics import Relations
    from ...io.tum import Trajectory

EXIT_INCOMPLETE = 1
"""Exit status if relations lie outside the trajectory's time: the figures are not those of the whole benchmark."""


def evaluate(
    trajectory: Annotated[
        Path,
        typer.Argument(
            metavar="TRAJECTORY",
            help="Trajectory in TUM format, t x y z qx qy qz qw per line, or output directory of a run.",
        ),
    ],
    relations: Annotated[
        Path | None, typer.Option("--relations", help="Relations: true motions between poses (Kuemmerle et al. 2009).")
    ] = None,
    reference: Annotated[
        Path | None,
        typer.Option("--reference", help="Reference trajectory in the same format, or output directory of a run."),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(
            "--recording",
            help="Recording of the drive: count the relations at which its scans fit better along the trajectory.",
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE.png", callback=check_picture, help="Picture of the errors.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one line of JSON instead of text.")] = False,
) -> None:
    """Score a trajectory against relations, a reference trajectory, or the ground truth in its recording.

    The output directory of a run needs neither option if the recording has ground truth, as those of `wclm simulate`.

    Exit status 1 if some relations lie outside the trajectory's time.

    Example: [bold]wclm eval out --relations intel.relations[/bold]
    """
    if relations is not None and reference is not None:
        raise typer.BadParameter("only one of the two can be given", param_hint="--relations / --reference")
    is_file = not trajectory.is_dir() and (trajectory.exists() or trajectory.suffix)  # by its name, if missing
    if relations is None and reference is None and is_file:
        text = (
            "one of the two is required, unless the trajectory is an output directory, whose recording may have truth"
        )
        raise typer.BadParameter(text, param_hint="--relations / --reference")
    if recording is not None and relations is None:
        raise typer.BadParameter("is for relations only", param_hint="--recording")
    if relations is not None:
        _against_relations(trajectory, relations, recording, plot, as_json)
    elif reference is not None:
        _against_reference(trajectory, _read(trajectory), reference, _read(reference), plot, as_json)
    else:
        _against_reference(trajectory, *_with_ground_truth(trajectory), plot, as_json)


def _read(path: Path) -> Trajectory:
    """Read a trajectory in a file, or in the output directory of a run. Raises MapError."""
    from ...io.tum import read_tum

    return read_tum(path / TRAJECTORY if path.is_dir() else path)


def _against_relations(
    trajectory: Path, relations: Path, recording: Path | None, plot: Path | None, as_json: bool
) -> None:
    from ...evaluation.metrics import read_relations, score_relations

    path, true = _read(trajectory), read_relations(relations)
    score = score_relations(path, true)
    figures = score.figures() | ({} if recording is None else _fit_figures(trajectory, path, true, recording))
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
    if recording is not None and not as_json:
        typer.echo(
            f"scans       fit better along the trajectory at {100 * figures['path_fits_better']:.0f} % of "
            f"{figures['compared']} relations, and at {100 * figures['path_fits_better_of_large']:.0f} % of "
            f"{figures['large_errors']} with the largest errors, from {figures['large_errors_from']:.3f} m on"
        )
    _warn_if_unrelated(trajectory, relations, score.unrelated)
    if plot is not None:
        from ...visualisation.plots import plot_relations

        plot_relations(plot, score, title=f"{trajectory.name} against {relations.name}")
    if score.missing:
        print_message(f"{trajectory}: {score.missing} relations lie outside the trajectory's time and are not scored")
        raise typer.Exit(EXIT_INCOMPLETE)


def _warn_if_unrelated(trajectory: Path, true: Path, unrelated: bool) -> None:
    """Print a warning if the stamps of trajectory and truth overlap by chance, and the drives are different ones."""
    if unrelated:
        print_message(f"{trajectory}: its turns are not those of {true}: are both of the same drive?")


def _fit_figures(results: Path, path: Trajectory, relations: Relations, recording: Path) -> dict[str, float]:
    """Return how well the scans of a recording fit; of `results` of a run, with its settings."""
    from drivers.messages import Scan

    from ...config import Config, LidarConfig
    from ...evaluation.relation_fit import compare_fits
    from ...io.recordings import open_source
    from ...io.run_results import read_run_results
    from ...io.scan_settings import as_used
    from ...preprocessing.deskew import lidar_mount

    config = Config()
    if results.is_dir():
        run = read_run_results(results)
        config = run.settings_as_used(run.recordings()[0])
    messages = (as_used(message, config) for message in open_source(recording, config))  # on the clock of the relations
    scans = (message for message in messages if isinstance(message, Scan) and not message.lidar)
    mounted = (replace(scan, mount=lidar_mount(scan, LidarConfig())) for scan in scans)
    return compare_fits(path, relations, mounted).figures()


def _with_ground_truth(out: Path) -> tuple[Trajectory, Path, Trajectory]:
    """Return the path of a run, the name of its recordings, and the true path in them. Raises MapError without one."""
    import numpy as np

    from drivers.messages import GroundTruth

    from ...errors import MapError
    from ...io.recordings import open_recording
    from ...io.run_results import read_run_results
    from ...io.tum import Trajectory

    results = read_run_results(out)
    source, delay = open_recording(results), results.settings_as_used(results.recordings()[-1]).lidar.delay
    truth = [message for message in source if isinstance(message, GroundTruth)]
    if not truth:
        raise MapError(f"{out}: {source.name} has no ground truth; name --reference or --relations")
    stamps = np.array([one.stamp for one in truth]) + (delay or 0.0)  # on the clock of the lidar, as the path is
    return results.trajectory, Path(source.name), Trajectory(stamps, np.array([one.pose for one in truth]))


def _against_reference(
    trajectory: Path, path: Trajectory, reference: Path, true: Trajectory, plot: Path | None, as_json: bool
) -> None:
    from ...evaluation.metrics import score_reference

    score = score_reference(path, true)
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
    _warn_if_unrelated(trajectory, reference, score.unrelated)
    if plot is not None:
        from ...visualisation.plots import plot_reference

        plot_reference(plot, score, title=f"{trajectory.name} against {reference.name}")
