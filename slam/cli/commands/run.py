"""`wclm run`: SLAM on a recording."""

from __future__ import annotations

import typer

from ..console import print_message
from ..options import (
    ConfigOption,
    ContinueOption,
    LocalizeOption,
    NoOdometryOption,
    OutOption,
    OverwriteOption,
    PlanLayerOption,
    PlanOption,
    PlanUnitOption,
    PlotOption,
    RecordingArgument,
    RefineOption,
    ReviewOption,
    SetOption,
    StartOption,
)


def run(
    recording: RecordingArgument,
    out: OutOption,
    overwrite: OverwriteOption = False,
    refine: RefineOption = False,
    no_odometry: NoOdometryOption = False,
    continued: ContinueOption = None,
    localized: LocalizeOption = None,
    plan: PlanOption = None,
    plan_unit: PlanUnitOption = None,
    plan_layer: PlanLayerOption = None,
    start_pose: StartOption = None,
    config: ConfigOption = None,
    settings: SetOption = None,
    review: ReviewOption = True,
    plot: PlotOption = False,
) -> None:
    """Map a recording: write trajectory, map and review log.

    With --continue the recording can start anywhere on the earlier map, or where the earlier run ended.

    Example: [bold]wclm run intel.clf --out results/intel --plot[/bold]
    """
    from ...io.output_dir import OutputDirectory
    from ...io.recordings import open_to_map, reason_without_odometry, recording_to_reopen
    from ...memory import return_freed_memory
    from ..plan_input import PlanOptions
    from ..run_input import RecordingInput
    from ..run_summary import format_summary
    from ..setup_from_options import setup_from_options, without_odometry
    from ..slam_run import run_slam

    if refine and localized is not None:
        raise typer.BadParameter("is for runs that extend a map, not for --localize", param_hint="--refine")
    OutputDirectory(out, overwrite).check()  # before the recording is read, which takes seconds
    start = setup_from_options(
        continued, localized, config, settings, start_pose, PlanOptions(plan, plan_unit, plan_layer or ())
    )
    source, reason = open_to_map(recording, start.config.without_odometry() if no_odometry else start.config)
    if no_odometry:
        start = without_odometry(start, "--no-odometry")
    elif reason is not None:
        start = without_odometry(start, f"{source.name}: {reason}")
    elif start.leaves_out_odometry and reason_without_odometry(source) is None:
        print_message(f"{source.name}: its odometry is not used, as the session was mapped without")
    run_input = RecordingInput(source, reopen=recording_to_reopen(recording), earlier=start.resumed)
    result = run_slam(run_input, start, out, overwrite=overwrite, review=review, picture=plot, refine=refine)
    typer.echo("\n".join(format_summary(result, out)))
    return_freed_memory()  # as the process ends, the code of all libraries is loaded once more
