"""Drawings of buildings that differ from an earlier map or from a plan, for the documentation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from ...io.output_dir import PLAN_PICTURE
from ..plan_input import PlanOptions, load_plan
from .demo_drawings import draw_changes

if TYPE_CHECKING:
    from drivers.messages import Source

    from ...mapping.plan_map import PlanMap

OFFICE_CHANGES = ("moved-20cm", "added", "closed-doors")
"""Changes of the office between two drives, of those in `slam.evaluation.benchmarks.map_changes`."""
OFFICE_SEEDS = 1, 2
"""Seeds of the two drives."""
MISSING_BOXES = 2
"""Pieces of furniture that are not in the plan of the office."""


class MapRecording(Protocol):
    """Function that maps a drive."""

    def __call__(self, source: str | Source, out: Path, *, plan: PlanMap | None = None) -> object:
        """Map a recording or a simulation, opened or by its name, into a directory, with a plan if there is one."""


def draw_office_changes(map_recording: MapRecording, directory: Path, scratch: Path) -> None:
    """Draw the differences between a drive through the office and one through a changed office as `changes.svg`."""
    from drivers.simulation import Simulation, build_world

    from ...evaluation.benchmarks.map_changes import CONDITIONS, office

    changed = office()
    for name in OFFICE_CHANGES:
        changed, _ = CONDITIONS[name].change(changed)
    outs = scratch / "old", scratch / "new"
    for out, content, seed in zip(outs, (office(), changed), OFFICE_SEEDS, strict=True):
        map_recording(Simulation(build_world("office", content), seed), out)
    draw_changes(directory / "changes.svg", *outs)


def draw_office_plan(map_recording: MapRecording, directory: Path, scratch: Path) -> None:
    """Draw the differences between the office and a partly wrong plan of it as `plan.svg`."""
    from drivers.simulation import Simulation, build_world

    from ...evaluation.benchmarks.map_changes import office
    from ...evaluation.benchmarks.plans import WRONG_SHARE, displace_walls, plan_of

    content = office()
    drawn, _ = displace_walls(content, WRONG_SHARE, OFFICE_SEEDS[0])
    drawn = drawn.model_copy(update={"boxes": drawn.boxes[:-MISSING_BOXES]})
    plan = plan_of(build_world("office", drawn))
    map_recording(Simulation(build_world("office", content), OFFICE_SEEDS[1]), scratch / "out", plan=plan)
    _keep_plan_picture(scratch / "out", directory / "plan.svg")


def draw_second_half(
    map_recording: MapRecording, recording: Path, picture: str, directory: Path, scratch: Path
) -> None:
    """Map the first half of a log of CARMEN, and the second half with it as a plan; draw the differences."""
    from ...config import Config

    lines = recording.read_bytes().splitlines(keepends=True)
    halves = scratch / "first.clf", scratch / "second.clf"
    for half, part in zip(halves, (lines[: len(lines) // 2], lines[len(lines) // 2 :]), strict=True):
        half.write_bytes(b"".join(part))
    map_recording(str(halves[0]), scratch / "first")
    plan = load_plan(scratch / "first", PlanOptions(scratch / "first"), Config())
    map_recording(str(halves[1]), scratch / "second", plan=plan)
    _keep_plan_picture(scratch / "second", directory / picture)


def _keep_plan_picture(out: Path, picture: Path) -> None:
    picture.write_bytes((out / PLAN_PICTURE).read_bytes())
