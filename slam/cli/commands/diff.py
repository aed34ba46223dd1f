"""`wclm diff`: changes between two maps of one building."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..console import print_if_slow, print_message
from ..options import OverwriteOption, PlanLayerOption, PlanUnitOption, parse_pose

if TYPE_CHECKING:
    from ...offline.map_diff.surveys import Survey
    from ..plan_input import PlanOptions

EXIT_DIFFERENT = 1
"""Exit status if the maps are different, as of diff."""


def diff(
    old: Annotated[Path, typer.Argument(metavar="OLD", help="Output directory of the earlier run, or a plan.")],
    new: Annotated[Path, typer.Argument(metavar="NEW", help="Output directory of the later run.")],
    false_discovery_rate: Annotated[
        float,
        typer.Option("--fdr", min=1e-9, max=0.5, help="Accepted share of false ones among the reported changes."),
    ] = 0.05,
    at: Annotated[
        str | None,
        typer.Option(
            "--at",
            metavar="X,Y,HEADING",
            help="Rough pose of the new map in the old one (metres, radians), if it is not recognised there.",
        ),
    ] = None,
    svg: Annotated[Path | None, typer.Option("--svg", metavar="FILE.svg", help="Picture of both maps.")] = None,
    geojson: Annotated[
        Path | None, typer.Option("--geojson", metavar="FILE.geojson", help="Changes as GeoJSON.")
    ] = None,
    plan_unit: PlanUnitOption = None,
    plan_layer: PlanLayerOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Compare two maps of one building: walls and corners that have moved, are gone or are new.

    Both maps are aligned by the walls that they have in common. A wall, or an end of it such as the jamb of a door, has
    moved if its new place is significantly different, given the joint covariances of both maps. A wall is gone if scans
    of the new run have seen through it, and new if scans of the old run have seen through its place. Walls that were
    not seen again are listed separately. The exit status is 0 if there is no such change, 1 if there is one, and 2
    after an error.

    Example: [bold]wclm diff monday tuesday --svg changes.svg[/bold]
    """
    from ...errors import MapError, OutputError
    from ...io.unfinished_file import unfinished_file
    from ...offline.map_diff import compare
    from ...offline.map_diff.corners import corner_changes
    from ...offline.map_diff.outputs import diff_text, write_diff_geojson, write_diff_svg
    from ...offline.map_diff.surveys import shared_scans
    from ..plan_input import PlanOptions

    for path, suffix in ((svg, ".svg"), (geojson, ".geojson")):
        if path is not None and path.suffix != suffix:
            raise OutputError(f"{path}: the name must end with {suffix}")
    guess = parse_pose(at, "--at")
    on_plan = PlanOptions(None, plan_unit, plan_layer or ())
    on_plan.check(old)
    earlier, later = _surveys(old, new, on_plan, guess is None)
    try:
        found = compare(earlier, later, false_discovery_rate, guess)
    except MapError as error:
        raise MapError(f"{old}, {new}: {error}") from error
    maps = earlier.wall_map, later.wall_map
    corners = corner_changes(found, *maps)
    with ExitStack() as files:
        if svg is not None:
            write_diff_svg(files.enter_context(unfinished_file(svg, overwrite)), found, *maps)
        if geojson is not None:
            write_diff_geojson(files.enter_context(unfinished_file(geojson, overwrite)), found, corners)
    typer.echo(diff_text(found, corners))
    if shared := shared_scans(earlier, later):
        print_message(
            f"{len(shared)} scans of {new} are also in {old}: differences that rest on them show the estimate, not the "
            "building; compare maps of separate drives"
        )
    if found.different:
        raise typer.Exit(EXIT_DIFFERENT)


def _surveys(old: Path, new: Path, on_plan: PlanOptions, searched: bool) -> tuple[Survey, Survey]:
    """Read the old map, which may be a plan, and the new one. Raises SlamError."""
    from ...config import load_config
    from ...io.output_dir import CONFIG
    from ...io.sessions import read_session
    from ...offline.map_diff import survey_session
    from ...offline.map_diff.plan import survey_plan
    from ...run_setup import is_plan
    from ..plan_input import load_plan
    from ..setup_from_options import READING_SESSION

    with print_if_slow(READING_SESSION):
        later = survey_session(new, read_session(new))
        if is_plan(old) or old.is_file():
            plan_map = load_plan(old, on_plan, load_config(new / CONFIG))
            return survey_plan(plan_map, searched=searched), later
        return survey_session(old, read_session(old)), later
