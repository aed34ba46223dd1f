"""Plans on the command line: files of other programs that are localised in or mapped with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from drivers.immutable import immutable

from .console import print_if_slow, print_message

if TYPE_CHECKING:
    from ..config import Config
    from ..io.plans.units import Unit
    from ..mapping.plan_map import PlanMap
    from ..measuring.wall_map import WallGeometry
    from ..offline.map_diff import MapDiff
    from ..pipeline import Slam

READING_PLAN = "reading the plan"


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """What the command line states about a plan.

    path    file or directory that `--plan` names; None without a plan
    unit    of a drawing; None for the one that the file states
    layers  of a DXF drawing; all if there is none
    """

    path: Path | None = None
    unit: Unit | None = None
    layers: Sequence[str] = ()

    def check(self, session: Path | None) -> None:
        """Check the options together with the `session` of other options. Raises BadParameter."""
        if self.path is not None and session is not None:
            raise typer.BadParameter("cannot be combined with --continue or --localize", param_hint="--plan")
        if self.path is None and (self.unit is not None or self.layers) and not (session and is_plan(session)):
            raise typer.BadParameter("no plan is given", param_hint="--plan-unit / --plan-layer")


NO_PLAN = PlanOptions()
"""Options of a run without a plan."""


def is_plan(path: Path) -> bool:
    """Return True if a path names a plan, and not the output directory of a run."""
    from ..io.plans.reader import is_plan_file

    return is_plan_file(path)


def load_plan(path: Path, options: PlanOptions, config: Config) -> PlanMap:
    """Read a plan, and print what had to be assumed. Raises SlamError naming the file."""
    from ..io.plans.reader import read_plan
    from ..mapping.plan_map import build_plan_map

    with print_if_slow(READING_PLAN):
        plan = read_plan(path, options.unit, options.layers)
        plan_map = build_plan_map(plan, (config.plan.sigma_offset, config.plan.sigma_heading))
    for note in plan.notes:
        print_message(f"{path}: {note}")
    width, height = plan.size
    print_message(f"{path}: {len(plan_map.walls)} walls, {width:.1f} m x {height:.1f} m")
    return plan_map


@immutable
class PlanReport:
    """Comparison of the finished map of a run with its plan.

    summary      for summary.json
    differences  None if the map was not recognised in the plan
    """

    summary: dict[str, Any]
    differences: MapDiff | None
    plan: WallGeometry | None = None
    built: WallGeometry | None = None

    def write(self, directory: Path) -> None:
        """Write the differences as GeoJSON and as a picture into the output directory. Raises OSError."""
        if self.differences is None or self.plan is None or self.built is None:
            return
        from ..io.output_dir import PLAN_DIFFERENCES, PLAN_PICTURE
        from ..offline.map_diff.corners import corner_changes
        from ..offline.map_diff.outputs import write_diff_geojson, write_diff_svg

        corners = corner_changes(self.differences, self.plan, self.built)
        write_diff_geojson(directory / PLAN_DIFFERENCES, self.differences, corners)
        write_diff_svg(directory / PLAN_PICTURE, self.differences, self.plan, self.built)


def report_on_plan(plan_map: PlanMap, slam: Slam) -> PlanReport:
    """Compare the finished map of a run with its plan."""
    from ..offline.map_diff.outputs import difference_lines
    from ..offline.map_diff.plan import compare_with_plan, survey_plan

    state = slam.slam_state
    recognised = state.plan is not None and state.plan.recognised
    summary: dict[str, Any] = {"file": plan_map.plan.name, "walls": len(plan_map.walls), "recognised": recognised}
    if not recognised:
        return PlanReport(summary, None)
    survey = survey_plan(plan_map)
    differences, built = compare_with_plan(survey, state, slam.session)
    summary |= {
        "supported": len(state.mapper.graph.plan_walls()),
        "differences": difference_lines(differences),
        "same": differences.same,
    }
    return PlanReport(summary, differences, survey.wall_map, built)
