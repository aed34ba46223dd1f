"""Comparison of the finished map of a run with the plan that it was made with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from drivers.immutable import immutable

from ...io.output_dir import PLAN_DIFFERENCES, PLAN_PICTURE
from ...mapping.plan_map import PlanMap
from ...measuring.wall_map import WallGeometry
from ...pipeline import Slam
from .changes import MapDiff
from .corners import corner_changes
from .outputs import difference_lines, write_diff_geojson, write_diff_svg
from .plan import compare_with_plan, survey_plan


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
        corners = corner_changes(self.differences, self.plan, self.built)
        write_diff_geojson(directory / PLAN_DIFFERENCES, self.differences, corners)
        write_diff_svg(directory / PLAN_PICTURE, self.differences, self.plan, self.built)


def report_on_plan(plan_map: PlanMap, slam: Slam) -> PlanReport:
    """Compare the finished map of a run with its plan."""
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
