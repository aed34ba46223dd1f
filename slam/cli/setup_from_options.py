"""What a run begins with, by the options of the command line: settings, and the session or the plan that it uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import typer

from ..config import load_config
from ..run_setup import RunSetup, is_plan, prepare_run
from .console import print_if_slow, print_message
from .options import parse_pose
from .plan_input import NO_PLAN, READING_PLAN, PlanOptions

READING_SESSION = "reading the session"


def setup_from_options(
    continued: Path | None,
    localized: Path | None,
    config: Path | None,
    settings: Sequence[str] | None,
    start: str | None,
    plan: PlanOptions = NO_PLAN,
) -> RunSetup:
    """Return what a run begins with: settings, and what `--continue`, `--localize` or `--plan` names.

    Settings come from `config`, else from the session, else from the defaults; `settings` override single ones. Raises
    SlamError if they are invalid, or if the session or the plan cannot be read or has no map.
    """
    if continued is not None and localized is not None:
        raise typer.BadParameter("only one of the two can be given", param_hint="--continue / --localize")
    session, pose = continued or localized, parse_pose(start, "--start")
    plan.check(session)
    if session is None and plan.path is None and pose is not None:
        raise typer.BadParameter("needs a map, by --continue, --localize or --plan", param_hint="--start")
    with print_if_slow(READING_SESSION if session is not None and not is_plan(session) else READING_PLAN):
        setup = prepare_run(
            lambda stored: load_config(config or stored, settings or ()),
            continued,
            localized,
            plan.path,
            pose,
            plan.drawing,
        )
    for note in setup.notes:
        print_message(note)
    return setup


def without_odometry(start: RunSetup, reason: str) -> RunSetup:
    """Return a setup that maps by the scans alone, and print so; `reason` is why."""
    print_message(f"{reason}: motions are predicted at constant velocity and corrected by the scans")
    return replace(start, config=start.config.without_odometry())
