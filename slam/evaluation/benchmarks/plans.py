"""Map simulated drives with a plan of the building, right or wrong, and compare the results with the truth.

The start of a drive is unknown. The plan has the frame of the world, so poses are compared without an alignment. A wall
of the plan is wrong if the building has none there. A wrong wall is found if the comparison of plan and map names it,
or a wall at its true place. A right wall is blamed if the comparison names it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import se2
from drivers.simulation import LIDAR_MODELS, WHEEL_MODELS, Simulation, build_world, load_world_file
from drivers.simulation.world import Wall, World, WorldFile

from ...config import Config
from ...mapping.map_features import MapWalls
from ...mapping.plan import Plan
from ...mapping.plan_map import PlanMap, build_plan_map
from ...offline.map_diff import Change, ChangeKind
from ...offline.map_diff.changes import DIFFERENCES
from ...offline.map_diff.plan import compare_with_plan, survey_plan
from ...pipeline import Slam
from ..ground_truth import match_walls, true_walls

WRONG_SHARE = 0.1
"""Share of the walls that are elsewhere in a wrong plan."""
MIN_SHIFT, MAX_SHIFT = 0.15, 0.5
"""Metres across by which such a wall is displaced: at least five standard deviations of a plan."""
SAME = 0.05
"""Metres within which two walls are the same."""
MIN_SEEN = 0.5
"""Metres of a wall that a map must contain for the wall to count as seen, as for an opening."""
PRECISION = 1e-3
"""Standard deviation of the points of the plan, metres."""


@dataclass(frozen=True, slots=True)
class PlanCondition:
    """A building, a robot and a plan.

    wrong  share of the walls that are elsewhere in the plan
    """

    description: str
    world: str
    lidar: str = "long"
    wheels: str = "good"
    wrong: float = 0.0


CONDITIONS: dict[str, PlanCondition] = {
    "right": PlanCondition("office, right plan", "office"),
    "wrong-walls": PlanCondition("office, 10 % of the walls of the plan displaced", "office", wrong=WRONG_SHARE),
    "large-loop": PlanCondition("large_loop, short-range lidar, worn wheels", "large_loop", "short", "bad"),
}


@dataclass(frozen=True, slots=True)
class PlanDrive:
    """Result of one drive with a plan.

    recognised_after  metres driven before the map was recognised in the plan; NaN if it was not
    rms, largest      errors of the positions of the keyframes in the plan's frame, metres; NaN if it was not recognised
    last              error of the last position, metres
    wrong             walls that are elsewhere in the plan, and that the map contains
    found             of these, those that the differences name
    blamed            differences that name something else
    """

    recognised_after: float
    rms: float
    largest: float
    last: float
    wrong: int
    found: int
    blamed: int


def map_with_plans(condition: str, seeds: Iterable[int], duration: float | None) -> Iterator[PlanDrive]:
    """Yield the result of a drive per seed; `duration` in seconds, None for the whole path."""
    chosen = CONDITIONS[condition]
    content = load_world_file(chosen.world)
    world = build_world(chosen.world, content)
    for seed in seeds:
        drawn, displaced = displace_walls(content, chosen.wrong, seed)
        drive = Simulation(world, seed, duration, LIDAR_MODELS[chosen.lidar], WHEEL_MODELS[chosen.wheels])
        plans = plan_of(build_world(chosen.world, drawn)), plan_of(world)
        yield _map_with_plan(drive, *plans, [(content.walls[k], drawn.walls[k]) for k in displaced])


def plan_of(world: World) -> PlanMap:
    """Return the plan that shows the straight walls of a world, with the default standard deviations."""
    segments, settings = world.segments.reshape(-1, 2, 2), Config().plan
    plan = Plan(world.name, segments, np.zeros(len(segments), dtype=bool), PRECISION)
    return build_plan_map(plan, (settings.sigma_offset, settings.sigma_heading))


def displace_walls(content: WorldFile, share: float, seed: int) -> tuple[WorldFile, list[int]]:
    """Return a world in which a share of the walls is displaced across, and the numbers of these walls."""
    random = np.random.default_rng(seed)
    walls = list(content.walls)
    chosen = sorted(random.choice(len(walls), round(share * len(walls)), replace=False).tolist())
    for k in chosen:
        shift = random.choice([-1.0, 1.0]) * random.uniform(MIN_SHIFT, MAX_SHIFT)
        start, end = np.array(walls[k].start), np.array(walls[k].end)
        x, y = ((end - start) / np.hypot(*(end - start))).tolist()
        across = shift * np.array([-y, x])
        moved = {"start": tuple((start + across).tolist()), "end": tuple((end + across).tolist())}
        walls[k] = walls[k].model_copy(update=moved)
    return content.model_copy(update={"walls": walls}), chosen


def _map_with_plan(
    drive: Simulation, plan_map: PlanMap, right: PlanMap, displaced: Sequence[tuple[Wall, Wall]]
) -> PlanDrive:
    """Map a drive with a plan; `right` is the right one, `displaced` as in `score`."""
    slam, recognised = Slam(plan=plan_map), np.nan
    for message in drive:
        slam.add(message)
        if np.isnan(recognised) and slam.slam_state.plan is not None and slam.slam_state.plan.recognised:
            recognised = message.stamp
    finished = slam.finish()
    state = slam.slam_state
    if state.plan is None or not state.plan.recognised:
        return PlanDrive(np.nan, np.nan, np.nan, np.nan, 0, 0, 0)
    truth = drive.trajectory.poses_at(finished.keyframes.stamps)
    steps = np.hypot(*np.diff(truth[:, :2], axis=0).T)
    errors = np.hypot(*(finished.keyframes.poses - truth)[:, :2].T)
    diff, built = compare_with_plan(survey_plan(plan_map), state, slam.session)
    reports = [change for change in diff.changes if change.kind in DIFFERENCES]
    return PlanDrive(
        float(steps[finished.keyframes.stamps[1:] <= recognised].sum()),
        float(np.sqrt(np.mean(errors**2))),
        float(errors.max()),
        float(errors[-1]),
        *score(reports, plan_map.walls, built.walls, (drive.world, right.walls), displaced),
    )


def score(
    reports: Sequence[Change],
    plan: MapWalls,
    built: MapWalls,
    building: tuple[World, MapWalls],
    displaced: Sequence[tuple[Wall, Wall]],
) -> tuple[int, int, int]:
    """Return how many of the displaced walls the map contains, how many of them are named, and how many others are.

    reports    differences between the plan and the map
    plan       walls of the plan
    built      walls of the map, in the plan's frame
    building   the world, and the walls of its right plan
    displaced  walls that are elsewhere in the plan: as they are, and as they are drawn

    A displaced wall uncovers and hides others: a wall of the plan is right if the right plan shows it as well, and a
    wall of the map is rightly named if the plan does not show it.
    """
    is_true, is_drawn = [_on(built, wall) for wall, _ in displaced], [_on(plan, wall) for _, wall in displaced]
    right, new = _shown(plan, building[1]), _exists(built, building[0]) & ~_shown(built, plan)
    lengths = np.array([float((pieces[:, 1] - pieces[:, 0]).sum()) for pieces in built.pieces])
    seen = {k for k, rows in enumerate(is_true) if lengths[rows].sum() >= MIN_SEEN}
    named, blamed = set[int](), 0
    for report in reports:
        if report.new is not None:  # a moved wall may be taken for another one of the plan that is nearer
            row = built.identity == report.new
            named |= {k for k, rows in enumerate(is_true) if rows[row].any()}
        if report.kind is ChangeKind.NEW:
            blamed += not new[row].any()
        else:
            row = plan.identity == report.old
            named |= {k for k, rows in enumerate(is_drawn) if rows[row].any()}
            blamed += bool(right[row].any())
    return len(seen), len(seen & named), blamed


def _on(walls: MapWalls, wall: Wall) -> NDArray[np.bool_]:
    """Return (n,) which walls of a map or a plan, in the frame of the world, are sides of a wall of the world."""
    true = true_walls(build_world("wall", WorldFile(path=[wall.start, wall.end], walls=[wall])), np.zeros(3))
    match = match_walls(walls, true)
    sides = se2.transform(se2.inverse(true.frame[match])[:, None], walls.end_points())
    return np.asarray((match >= 0) & (np.abs(sides[..., 1]).max(axis=1) <= SAME))


def _shown(walls: MapWalls, others: MapWalls) -> NDArray[np.bool_]:
    """Return (n,) which walls are among others: on one line in one direction, side by side."""
    ends = se2.transform(se2.inverse(others.frame)[:, None, None], walls.end_points()[None])  # (other, wall, end, xy)
    ahead = np.cos(others.frame[:, None, 2] - walls.frame[None, :, 2]) > 0.0
    beside = (ends[..., 1, 0] > others.low[:, None]) & (ends[..., 0, 0] < others.high[:, None])
    return np.asarray((ahead & beside & (np.abs(ends[..., 1]).max(axis=-1) <= SAME)).any(axis=0))


def _exists(walls: MapWalls, world: World) -> NDArray[np.bool_]:
    """Return (n,) which walls of a map are walls of the world, or chords of its columns."""
    middle = walls.end_points().mean(axis=1)
    away = np.hypot(*(middle[:, None] - world.circles[None, :, :2]).transpose(2, 0, 1)) - world.circles[:, 2]
    return np.asarray((match_walls(walls, true_walls(world, np.zeros(3))) >= 0) | (np.abs(away) <= SAME).any(axis=1))


def plans_table(results: Mapping[str, Sequence[PlanDrive]]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = [
        "| condition | drives | recognised | after | error, RMS | largest | at the end | wrong walls found |"
        " right ones blamed |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, drives in results.items():
        known = [drive for drive in drives if np.isfinite(drive.rms)]
        cells = [CONDITIONS[name].description, str(len(drives)), f"{len(known)}"]
        if known:
            after = np.array([drive.recognised_after for drive in known])
            errors = np.array([(drive.rms, drive.largest, drive.last) for drive in known])
            rms = 1e3 * float(np.sqrt(np.mean(errors[:, 0] ** 2)))
            largest, last = (1e3 * errors[:, 1:].max(axis=0)).tolist()
            wrong, found = sum(drive.wrong for drive in known), sum(drive.found for drive in known)
            cells += [f"{np.median(after):.1f} m (up to {after.max():.1f} m)", f"{rms:.1f} mm", f"{largest:.1f} mm"]
            cells += [f"{last:.1f} mm", f"{found} of {wrong}" if wrong else "-"]
            cells.append(str(sum(drive.blamed for drive in known)))
        else:
            cells += ["-"] * 6
        lines.append(f"| {' | '.join(cells)} |")
    return lines
