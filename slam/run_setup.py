"""What a run begins with: settings, and the session or the plan that it uses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from drivers import se2
from drivers.immutable import immutable

from .config import Config
from .errors import MapError
from .io.output_dir import CONFIG

if TYPE_CHECKING:
    from .io.plans.units import Unit
    from .io.sessions import StoredSession
    from .mapping.plan_map import PlanMap


@immutable
class RunSetup:
    """Initial state of a run.

    config   settings
    resumed  session to continue, if any
    frozen   True to localise on the map of `resumed` without changing it
    pose     roughly known pose of the base in that map, or in the plan, at the beginning; None if it may be anywhere
    plan     plan to map with, if any
    notes    size of a plan, and what had to be assumed of it, as lines of text
    """

    config: Config
    resumed: StoredSession | None = None
    frozen: bool = False
    pose: se2.Pose | None = None
    plan: PlanMap | None = None
    notes: Sequence[str] = ()

    @property
    def leaves_out_odometry(self) -> bool:
        """True if there is a session that was mapped by the scans alone, so that the run is mapped likewise."""
        return self.resumed is not None and self.config.odometry.source == "none"


@immutable
class PlanDrawing:
    """How the drawing of a plan is read.

    unit    of length; None for the one that the file states
    layers  of a DXF drawing; all if there is none
    """

    unit: Unit | None = None
    layers: Sequence[str] = ()

    @property
    def is_stated(self) -> bool:
        """True if anything is stated."""
        return self.unit is not None or bool(self.layers)


AS_DRAWN = PlanDrawing()
"""Reading of a drawing as it states itself."""


def is_plan(path: Path) -> bool:
    """Return True if a path names a plan, and not the output directory of a run."""
    from .io.plans.reader import is_plan_file

    return is_plan_file(path)


def prepare_run(
    settings: Callable[[Path | None], Config],
    continued: Path | None = None,
    localized: Path | None = None,
    plan: Path | None = None,
    pose: se2.Pose | None = None,
    drawing: PlanDrawing = AS_DRAWN,
) -> RunSetup:
    """Read the session that a run continues, or the session or plan that it localises in, or the plan it maps with.

    settings  returns the settings, given the file with those of the session; None without a session
    pose      roughly known pose [x, y, heading] of the base at the beginning; None if it may be anywhere
    drawing   how a plan is read

    Raises SlamError if these contradict each other, or if the session or the plan cannot be read or has no map.
    """
    session = continued or localized
    if sum(path is not None for path in (continued, localized, plan)) > 1:
        raise MapError("a run can continue a session, localise on a map, or map with a plan, but only one of these")
    if session is None and plan is None and pose is not None:
        raise MapError(
            "an initial pose (start) needs a map: that of a session to continue or to localise on, or a plan"
        )
    if drawing.is_stated and plan is None and (session is None or not is_plan(session)):
        raise MapError("the unit or layers of a plan are stated, but no plan is given")
    if session is None or is_plan(session) or (localized and localized.is_file()):  # if no plan, reading it says so
        config = settings(None)
        if session is None:
            plan_map, notes = (None, ()) if plan is None else read_plan_map(plan, drawing, config)
            return RunSetup(config, None, False, pose, plan_map, notes)
        if localized is None:
            raise MapError(f"{session}: is a plan and no session to continue; map with it as a plan")
        from .io.sessions.plan_session import plan_session

        plan_map, notes = read_plan_map(session, drawing, config)
        return RunSetup(config, plan_session(plan_map, config), True, pose, notes=notes)
    from .io.sessions import read_session

    resumed = read_session(session, solve=continued is None)
    if not resumed.slam_state.mapper.keyframe_count:
        raise MapError(f"{session}: has no keyframe and cannot be continued")
    return RunSetup(settings(session / CONFIG), resumed, localized is not None, pose)


def read_plan_map(path: Path, drawing: PlanDrawing, config: Config) -> tuple[PlanMap, list[str]]:
    """Read a plan; return it with its size and what had to be assumed, as lines of text. Raises SlamError."""
    from .io.plans.reader import read_plan
    from .mapping.plan_map import build_plan_map

    plan = read_plan(path, drawing.unit, drawing.layers)
    plan_map = build_plan_map(plan, (config.plan.sigma_offset, config.plan.sigma_heading))
    width, height = plan.size
    notes = [*plan.notes, f"{len(plan_map.walls)} walls, {width:.1f} m x {height:.1f} m"]
    return plan_map, [f"{path}: {note}" for note in notes]
