"""Plans on the command line: files of other programs that are localised in or mapped with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ..run_setup import PlanDrawing, is_plan, read_plan_map
from .console import print_if_slow, print_message

if TYPE_CHECKING:
    from ..config import Config
    from ..io.plans.units import Unit
    from ..mapping.plan_map import PlanMap

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

    @property
    def drawing(self) -> PlanDrawing:
        """How the plan is read."""
        return PlanDrawing(self.unit, self.layers)

    def check(self, session: Path | None) -> None:
        """Check the options together with the `session` of other options. Raises BadParameter."""
        if self.path is not None and session is not None:
            raise typer.BadParameter("cannot be combined with --continue or --localize", param_hint="--plan")
        if self.path is None and self.drawing.is_stated and not (session and is_plan(session)):
            raise typer.BadParameter("no plan is given", param_hint="--plan-unit / --plan-layer")


NO_PLAN = PlanOptions()
"""Options of a run without a plan."""


def load_plan(path: Path, options: PlanOptions, config: Config) -> PlanMap:
    """Read a plan, and print its size and what had to be assumed. Raises SlamError naming the file."""
    with print_if_slow(READING_PLAN):
        plan_map, notes = read_plan_map(path, options.drawing, config)
    for note in notes:
        print_message(note)
    return plan_map
