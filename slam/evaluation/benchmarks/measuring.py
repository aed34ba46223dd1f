"""Test the standard deviations of measurements over simulated drives with independent noise.

Each drive is one draw: its measurements have errors in common. For each kind of measurement, the share within 1.96
standard deviations of the truth, which should be 95 %, and the mean square of error by standard deviation, which should
be one, are averaged over the drives.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from drivers import se2
from drivers.immutable import immutable
from drivers.simulation import Simulation, World

from ...estimation.joint_covariance import joint_wall_covariance
from ...geometry.segments import Floats
from ...measuring.measurement import Kind, Measurement, measure_distance
from ...measuring.rooms import Room, build_room, find_rooms, measure_room, outline_along
from ...measuring.visible_pairs import measure_pairs
from ...measuring.wall_map import WallMap
from ...pipeline import Slam
from ..ground_truth import match_walls, true_walls

PROBABILITY = 0.95
"""Share of the measurements that should be within the interval."""
INTERVAL = NormalDist().inv_cdf(0.5 + PROBABILITY / 2)
"""Half width of the interval, in standard deviations: 1.96."""


@immutable
class MeasuredDrive:
    """Errors of the measurements of one drive divided by their standard deviations, (n,) for each kind."""

    errors: dict[Kind, Floats]


@dataclass(frozen=True, slots=True)
class CoverageRow:
    """Coverage of one kind of measurement.

    name            of the kind
    drives          with such a measurement
    count           number of measurements
    covered         mean share within INTERVAL standard deviations
    covered_error   its standard error, from the scatter of the drives; NaN for one drive
    squared         mean squared error by variance; 1 is consistent, more is overconfident
    """

    name: str
    drives: int
    count: int
    covered: float
    covered_error: float
    squared: float


def measure_drives(seeds: Iterable[int], world: str, duration: float | None) -> Iterator[MeasuredDrive]:
    """Yield the errors of each simulated drive; `duration` in seconds, None for the whole path."""
    for seed in seeds:
        yield MeasuredDrive(_errors(*map_drive(Simulation(world, seed, duration))))


def map_drive(drive: Simulation) -> tuple[WallMap, WallMap, frozenset[int]]:
    """Map a simulated drive; return the map, and what `true_map` returns of it."""
    slam = Slam()
    for message in drive:
        slam.add(message)
    finished = slam.finish()
    covariance = joint_wall_covariance(slam.slam_state.mapper, finished.walls)
    wall_map = WallMap(finished.walls, finished.corners, covariance, finished.keyframes.poses[:, :2])
    return wall_map, *true_map(wall_map, drive.world, drive.trajectory.poses_at(finished.keyframes.stamps[:1])[0])


def true_map(wall_map: WallMap, world: World, origin: se2.Pose) -> tuple[WallMap, frozenset[int]]:
    """Return the map with the true lines of its walls, and the rows of the walls that are walls of the world.

    origin  [x, y, heading] of the map in the world
    """
    walls, true = wall_map.walls, true_walls(world, origin)
    match = match_walls(walls, true)
    found = np.flatnonzero(match >= 0)
    relative = se2.between(true.frame[match[found]], walls.frame[found]).reshape(-1, 3)
    beside = np.column_stack([relative[:, 0], np.zeros((len(found), 2))])
    frame = walls.frame.copy()
    frame[found] = se2.compose(true.frame[match[found]], beside)
    return replace(wall_map, walls=replace(walls, frame=frame)), frozenset(found.tolist())


def _errors(wall_map: WallMap, truth: WallMap, known: frozenset[int]) -> dict[Kind, Floats]:
    """Return the errors of all measurements of walls that have a truth."""
    errors: dict[Kind, list[float]] = {}
    for measured, true in [*_pairs(wall_map, truth, known), *_rooms(wall_map, truth, known)]:
        errors.setdefault(measured.kind, []).append((measured.value - true.value) / measured.sigma)
    return {kind: np.array(values) for kind, values in errors.items()}


def _pairs(wall_map: WallMap, truth: WallMap, known: frozenset[int]) -> Iterator[tuple[Measurement, Measurement]]:
    for measured in measure_pairs(wall_map):
        first, second = (wall_map.row(identity) for identity in measured.walls)
        if {first, second} <= known:
            along = wall_map.along(first, measured.ends[0])
            yield measured, measure_distance(truth, first, second, measured.kind, along)


def _rooms(wall_map: WallMap, truth: WallMap, known: frozenset[int]) -> Iterator[tuple[Measurement, Measurement]]:
    for room in find_rooms(wall_map):
        parts = [room.outline, *room.islands]
        if all(stretch.wall in known for part in parts for stretch in part.stretches):
            measured, true = measure_room(wall_map, room), measure_room(truth, _same_room(truth, room))
            yield from zip(measured, true, strict=True)


def _same_room(truth: WallMap, room: Room) -> Room:
    """Return a room with the same walls in the true map."""
    outline, *islands = (outline_along(truth, part.stretches) for part in (room.outline, *room.islands))
    return build_room(truth, room.number, outline, islands)


def coverage(drives: Sequence[MeasuredDrive]) -> list[CoverageRow]:
    """Return the coverage of each kind of measurement, in the order of the kinds."""
    rows = []
    for kind in Kind:
        values = [drive.errors[kind] for drive in drives if kind in drive.errors]
        if not values:
            continue
        covered = np.array([np.mean(np.abs(errors) <= INTERVAL) for errors in values])
        error = float(covered.std(ddof=1)) / len(covered) ** 0.5 if len(covered) > 1 else float("nan")
        squared = float(np.mean([np.mean(errors**2) for errors in values]))
        count = sum(len(errors) for errors in values)
        rows.append(CoverageRow(kind.value, len(values), count, float(covered.mean()), error, squared))
    return rows


def coverage_table(rows: Sequence[CoverageRow]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = [
        f"| measurement | drives | measurements | within {INTERVAL:.2f} σ | mean of (error / σ)² |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        covered = f"{100 * row.covered:.1f} ± {100 * row.covered_error:.1f} %"
        lines.append(f"| {row.name} | {row.drives} | {row.count} | {covered} | {row.squared:.2f} |")
    return lines
