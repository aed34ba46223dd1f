"""Compare maps of pairs of simulated drives, through an unchanged office and through one with known changes.

Each condition changes the building between the two drives. A change is found if a wall within it, or at most MARGIN
metres beside it, is reported as moved, gone or new. A report anywhere else is a false discovery.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers import se2
from drivers.simulation import Simulation
from drivers.simulation.world import Box, World, WorldFile, build_world, load_world_file

from ...geometry.segments import Floats
from ...offline.map_diff import MapDiff, Survey, compare, survey_session
from ...offline.map_diff.changes import DIFFERENCES
from ...pipeline import Slam
from ..rates import upper_limit

MARGIN = 0.3
"""Metres around a change within which a report counts as finding it."""
MOVED_BOXES = {
    (7.4, 5.6): (0.0, -1.0), (10.75, 2.4): (1.0, 0.0), (15.5, 1.3): (-1.0, 0.0), (22.4, 4.7): (0.0, 1.0),
    (24.2, 10.0): (-1.0, 0.0), (22.2, 10.5): (0.0, -1.0), (24.2, 5.2): (-1.0, 0.0), (11.4, 0.8): (0.0, 1.0),
    (13.3, 0.7): (0.0, 1.0), (17.4, 9.4): (0.0, 1.0),
}  # fmt: skip
"""Centres of boxes of the office that the robot sees within 100 s, and the directions in which they are moved."""
ADDED_BOXES = (
    ((11.6, 1.9), (0.5, 0.5)), ((24.3, 7.0), (0.6, 0.8)), ((16.5, 4.26), (1.0, 0.4)), ((8.9, 10.78), (1.0, 0.32)),
    ((21.6, 5.0), (0.4, 0.4)), ((5.9, 5.7), (0.3, 0.3)),
)  # fmt: skip
"""Centres and sizes of the boxes that are added, metres."""
DOORS = ((17.2, 4.0), (7.6, 11.0))
"""Begins of doors that the robot drives past: the southern wall is at y = 4, the northern one at y = 11."""

Areas = Sequence[tuple[float, float, float, float]]
"""Changed areas: centre x, y and half sizes, metres in the world."""


@dataclass(frozen=True, slots=True)
class ChangeCondition:
    """Changes of the office between two drives."""

    description: str
    change: Callable[[WorldFile], tuple[WorldFile, Areas]]


def _unchanged(content: WorldFile) -> tuple[WorldFile, Areas]:
    return content, ()


def _move_boxes(distance: float) -> Callable[[WorldFile], tuple[WorldFile, Areas]]:
    def change(content: WorldFile) -> tuple[WorldFile, Areas]:
        boxes, areas = [], []
        for box in content.boxes:
            direction = MOVED_BOXES.get(box.at)
            if direction is not None:
                areas.append((*box.at, 0.5 * box.size[0] + distance, 0.5 * box.size[1] + distance))
                to = (box.at[0] + distance * direction[0], box.at[1] + distance * direction[1])
                box = box.model_copy(update={"at": to})
            boxes.append(box)
        return content.model_copy(update={"boxes": boxes}), areas

    return change


def _add_boxes(content: WorldFile) -> tuple[WorldFile, Areas]:
    added = [Box(at=at, size=size) for at, size in ADDED_BOXES]
    areas = [(*at, 0.5 * size[0], 0.5 * size[1]) for at, size in ADDED_BOXES]
    return content.model_copy(update={"boxes": [*content.boxes, *added]}), areas


def _change_doors(
    edit: Callable[[tuple[float, float]], list[tuple[float, float]]],
) -> Callable[[WorldFile], tuple[WorldFile, Areas]]:
    """Return a change of DOORS; `edit` returns what is left of a door, its begin and width."""

    def change(content: WorldFile) -> tuple[WorldFile, Areas]:
        walls, areas = [], []
        for wall in content.walls:
            doors: list[tuple[float, float]] = []
            for door in wall.doors:
                if (door[0], wall.start[1]) in DOORS and wall.start[1] == wall.end[1]:
                    doors += edit(door)
                    areas.append((door[0] + 0.5 * door[1], wall.start[1], 0.5 * door[1], 0.5 * wall.thickness))
                else:
                    doors.append(door)
            walls.append(wall.model_copy(update={"doors": doors}))
        return content.model_copy(update={"walls": walls}), areas

    return change


def _shift_doors(distance: float) -> Callable[[WorldFile], tuple[WorldFile, Areas]]:
    return _change_doors(lambda door: [(door[0] + distance, door[1])])


CONDITIONS: dict[str, ChangeCondition] = {
    "unchanged": ChangeCondition("nothing has changed", _unchanged),
    "moved-2cm": ChangeCondition("10 boxes moved by 2 cm", _move_boxes(0.02)),
    "moved-5cm": ChangeCondition("10 boxes moved by 5 cm", _move_boxes(0.05)),
    "moved-10cm": ChangeCondition("10 boxes moved by 10 cm", _move_boxes(0.1)),
    "moved-20cm": ChangeCondition("10 boxes moved by 20 cm", _move_boxes(0.2)),
    "added": ChangeCondition("6 boxes added", _add_boxes),
    "closed-doors": ChangeCondition("2 doors closed", _change_doors(lambda door: [])),
    "shifted-5cm": ChangeCondition("2 doors shifted by 5 cm along the wall", _shift_doors(0.05)),
    "shifted-10cm": ChangeCondition("2 doors shifted by 10 cm along the wall", _shift_doors(0.1)),
    "shifted-20cm": ChangeCondition("2 doors shifted by 20 cm along the wall", _shift_doors(0.2)),
}


@dataclass(frozen=True, slots=True)
class PairResult:
    """Comparison of one pair of drives.

    changes  number of changes of the building
    found    number of these that were found
    reports  number of reported changes
    false    number of reports that belong to no change
    """

    changes: int
    found: int
    reports: int
    false: int


def compare_pairs(condition: str, seeds: Iterable[int], duration: float, rate: float) -> Iterator[PairResult]:
    """Yield the result of a pair of drives per seed, which have the seeds 2 s and 2 s + 1.

    duration  of each drive, seconds
    rate      accepted false-discovery rate
    """
    content = office()
    changed, areas = CONDITIONS[condition].change(content)
    for seed in seeds:
        old, origin = _survey(build_world("office", content), 2 * seed, duration)
        new, _ = _survey(build_world("office", changed), 2 * seed + 1, duration)
        yield score(compare(old, new, rate), areas, origin)


def office() -> WorldFile:
    """Return the content of the office's file."""
    return load_world_file("office")


def _survey(world: World, seed: int, duration: float) -> tuple[Survey, se2.Pose]:
    """Map a drive; return the survey and the pose of its map in the world."""
    drive, slam = Simulation(world, seed, duration), Slam()
    for message in drive:
        slam.add(message)
    finished = slam.finish()
    origin = drive.trajectory.poses_at(finished.keyframes.stamps[:1])[0]
    return survey_session(Path(world.name), slam.session), origin


def score(diff: MapDiff, areas: Areas, origin: se2.Pose) -> PairResult:
    """Return which changes were found; `origin` is the pose of the old map in the world."""
    reports = [change for change in diff.changes if change.kind in DIFFERENCES]
    found: set[int] = set()
    false = 0
    for report in reports:
        middle = se2.transform(origin, report.stretches.mean(axis=1)).reshape(-1, 2)
        near = {k for k, area in enumerate(areas) if _within(middle, area)}
        found |= near
        false += not near
    return PairResult(len(areas), len(found), len(reports), false)


def _within(points: Floats, area: tuple[float, float, float, float]) -> bool:
    x, y, half_x, half_y = area
    inside = (np.abs(points[:, 0] - x) < half_x + MARGIN) & (np.abs(points[:, 1] - y) < half_y + MARGIN)
    return bool(inside.any())


def changes_table(results: Mapping[str, Sequence[PairResult]]) -> list[str]:
    """Return the lines of a Markdown table.

    The false-discovery rate is the mean share of false ones among the reports of a pair; a pair without a report has
    none. Its upper limit at 95 % confidence is for the pairs in which there is any.
    """
    lines = [
        "| condition | pairs | changes found | pairs with a false discovery (95 % limit) | false-discovery rate |",
        "|---|---|---|---|---|",
    ]
    for name, pairs in results.items():
        changes, found = sum(pair.changes for pair in pairs), sum(pair.found for pair in pairs)
        wrong = sum(pair.false > 0 for pair in pairs)
        rate = float(np.mean([pair.false / max(pair.reports, 1) for pair in pairs]))
        recall = f"{found} of {changes}" if changes else "-"
        limit = f"{wrong} (< {100 * upper_limit(wrong, len(pairs)):.0f} %)"
        lines.append(f"| {CONDITIONS[name].description} | {len(pairs)} | {recall} | {limit} | {100 * rate:.1f} % |")
    return lines
