"""What a run begins with: settings, and the session or the plan that it uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from drivers import se2
from drivers.immutable import immutable

from ..config import Config, load_config
from ..errors import MapError
from ..io.output_dir import CONFIG
from .console import print_if_slow, print_message
from .options import parse_pose
from .plan_input import NO_PLAN, PlanOptions, is_plan, load_plan

if TYPE_CHECKING:
    from ..io.sessions import StoredSession
    from ..mapping.plan_map import PlanMap

READING_SESSION = "reading the session"


@immutable
class RunSetup:
    """Initial state of a run.

    config   settings
    resumed  session to continue, if any
    frozen   True to localise on the map of `resumed` without changing it
    pose     roughly known pose of the base in that map, or in the plan, at the beginning; None if it may be anywhere
    plan     plan to map with, if any
    """

    config: Config
    resumed: StoredSession | None = None
    frozen: bool = False
    pose: se2.Pose | None = None
    plan: PlanMap | None = None

    @property
    def leaves_out_odometry(self) -> bool:
        """True if there is a session that was mapped by the scans alone, so that the run is mapped likewise."""
        return self.resumed is not None and self.config.odometry.source == "none"


def prepare_run(
    continued: Path | None,
    localized: Path | None,
    config: Path | None,
    settings: Sequence[str] | None,
    start: str | None,
    plan: PlanOptions = NO_PLAN,
) -> RunSetup:
    """Load the settings, and the session or the plan that `--continue`, `--localize` or `--plan` names.

    Settings come from `config`, else from the session, else from the defaults; `settings` override single ones. Raises
    SlamError if they are invalid, or if the session or the plan cannot be read or has no map.
    """
    if continued is not None and localized is not None:
        raise typer.BadParameter("only one of the two can be given", param_hint="--continue / --localize")
    plan.check(continued or localized)
    session, pose = continued or localized, parse_pose(start, "--start")
    if session is None and plan.path is None and pose is not None:
        raise typer.BadParameter("needs a map, by --continue, --localize or --plan", param_hint="--start")
    if session is None or is_plan(session) or (localized and localized.is_file()):  # if no plan, reading it says so
        loaded = load_config(config, settings or ())
        if session is None:
            return RunSetup(
                loaded, None, False, pose, None if plan.path is None else load_plan(plan.path, plan, loaded)
            )
        if localized is None:
            raise MapError(f"{session}: is a plan and no session to continue; --plan maps with it")
        from ..io.sessions.plan_session import plan_session

        return RunSetup(loaded, plan_session(load_plan(session, plan, loaded), loaded), True, pose)
    from ..io.sessions import read_session

    with print_if_slow(READING_SESSION):
        resumed = read_session(session, solve=continued is None)
    if not resumed.slam_state.mapper.keyframe_count:
        raise MapError(f"{session}: has no keyframe and cannot be continued")
    return RunSetup(load_config(config or session / CONFIG, settings or ()), resumed, localized is not None, pose)


def without_odometry(start: RunSetup, reason: str) -> RunSetup:
    """Return a setup that maps by the scans alone, and print so; `reason` is why."""
    print_message(f"{reason}: motions are predicted at constant velocity and corrected by the scans")
    return replace(start, config=start.config.without_odometry())
