"""Impose right angles and parallels on maps of simulated drives, and compare the directions of walls with the truth.

Some walls of the building are skewed: turned about their middle by a small angle. A wall is made regular rightly if its
true direction is that of most walls of its group, modulo 90 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from drivers import se2
from drivers.simulation import Simulation, build_world, load_world_file
from drivers.simulation.world import WorldFile

from ...geometry.segments import Floats
from ...measuring.regularity import regularise
from ...measuring.wall_map import WallMap
from .measuring import map_drive

SKEWED_SHARE = 0.15
"""Share of the walls that are skewed."""
LONGEST_SKEWED = 8.0
"""Metres of the longest wall that is skewed: the ends of a longer one would leave the corners of the building open."""
SAME_DIRECTION = 1e-3
"""Radians between the true directions of walls that are parallel: far less than any skew, far more than rounding."""


@dataclass(frozen=True, slots=True)
class RegularDrive:
    """Result of one drive.

    walls          of the map that are walls of the building
    regular        of these, those that were made regular
    skewed         walls of the map that are skewed in the building
    wrong          walls that were made regular, though their true direction is not that of their group
    before, after  errors (RMS) of the directions of the regular walls about their mean, radians
    """

    walls: int
    regular: int
    skewed: int
    wrong: int
    before: float
    after: float


def regularise_drives(seeds: Iterable[int], world: str, duration: float | None, skew: float) -> Iterator[RegularDrive]:
    """Yield the result of each simulated drive; `duration` in seconds, None for the whole path.

    skew  angle by which walls are turned, one way or the other, radians
    """
    content = load_world_file(world)
    for seed in seeds:
        drive = Simulation(build_world(world, skew_walls(content, skew, seed)), seed, duration)
        yield score(*map_drive(drive), skew)


def skew_walls(content: WorldFile, skew: float, seed: int) -> WorldFile:
    """Return a world in which a share of the walls is turned about their middles by plus or minus an angle, radians."""
    random = np.random.default_rng(seed)
    walls = list(content.walls)
    lengths = [math.dist(wall.start, wall.end) for wall in walls]
    short = [k for k, length in enumerate(lengths) if length <= LONGEST_SKEWED]
    for k in sorted(random.choice(short, round(SKEWED_SHARE * len(short)), replace=False).tolist()):
        ends = np.array([walls[k].start, walls[k].end])
        middle, turn = ends.mean(axis=0), np.array([0.0, 0.0, random.choice([-skew, skew])])
        start, end = (middle + se2.transform(turn, ends - middle)).tolist()
        walls[k] = walls[k].model_copy(update={"start": tuple(start), "end": tuple(end)})
    return content.model_copy(update={"walls": walls})


def score(wall_map: WallMap, truth: WallMap, known: frozenset[int], skew: float) -> RegularDrive:
    """Return how right angles and parallels change a map.

    truth  the map with the true lines of its walls
    known  rows of the walls that are walls of the building
    skew   angle by which some walls are turned, radians
    """
    result, true = regularise(wall_map), truth.walls.frame[:, 2]
    rows = np.array(sorted(known), dtype=np.int64)
    groups = [np.intersect1d(group, rows) for group in result.groups]
    wrong = sum(int((np.abs(_from_common(true[group])) > SAME_DIRECTION).sum()) for group in groups)
    regular = np.concatenate([np.zeros(0, dtype=np.int64), *groups])
    before, after = (se2.wrap(one.walls.frame[regular, 2] - true[regular]) for one in (wall_map, result.wall_map))
    turned = np.abs(np.abs(_from_common(true[rows])) - skew) < SAME_DIRECTION if skew else np.zeros(len(rows), bool)
    return RegularDrive(len(rows), len(regular), int(turned.sum()), wrong, _scatter(before), _scatter(after))


def _from_common(directions: Floats) -> Floats:
    """Return the differences (n,) of directions from that of most of them, modulo 90 degrees."""
    quarter = 0.5 * math.pi
    apart = directions - directions[:, None]
    apart -= quarter * np.round(apart / quarter)
    most = (np.abs(apart) < SAME_DIRECTION).sum(axis=1).argmax() if len(directions) else 0
    return np.asarray(apart[most] if len(directions) else directions)


def _scatter(errors: Floats) -> float:
    """Return the RMS of errors about their mean; NaN without any."""
    return float(errors.std()) if len(errors) else math.nan


def regularity_table(rows: Sequence[tuple[float, Sequence[RegularDrive]]]) -> list[str]:
    """Return the lines of a Markdown table; each row has a skew (radians) and drives with it."""
    lines = [
        "| skew | drives | walls | made regular | of them wrongly | skewed walls | directions before, RMS | after |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for skew, drives in rows:
        counts = [sum(getattr(drive, name) for drive in drives) for name in ("walls", "regular", "wrong", "skewed")]
        before, after = (
            math.degrees(math.sqrt(np.nanmean([getattr(drive, name) ** 2 for drive in drives])))
            for name in ("before", "after")
        )
        cells = [f"{math.degrees(skew):g}°", str(len(drives)), *map(str, counts), f"{before:.3f}°", f"{after:.3f}°"]
        lines.append(f"| {' | '.join(cells)} |")
    return lines
