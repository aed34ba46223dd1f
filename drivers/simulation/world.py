"""Worlds to simulate in: walls, doors, furniture and round columns from a small TOML file.

    title = "one room with a box"
    speed = 0.5                                  # metres a second
    path = [[1, 1], [5, 1], [5, 3]]              # way points; the robot starts at the first

    [[walls]]
    from = [0, 0]
    to = [6, 0]
    thickness = 0.12                             # 0 where left out
    doors = [[2.0, 0.9]]                         # openings: where along the wall one begins, and its width

    [[boxes]]
    at = [3, 2]                                  # the centre
    size = [1.6, 0.8]
    turn = 15                                    # degrees, 0 where left out

    [[columns]]
    at = [4, 4]
    radius = 0.25

Whatever has `since` or `until` (seconds after the start) stands there only then: furniture is moved while the robot is
elsewhere, and doors are shut.

Lengths are metres. A wall with a thickness shows both its faces, and the jambs of its doors; its centre line
runs from `from` to `to`, and it is as much longer at either end as half its thickness, so that walls meet in
closed corners.
"""

from __future__ import annotations

import math
import tomllib
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .. import se2
from ..errors import RecordingError
from ..messages import Floats

Metres = Annotated[float, Field(allow_inf_nan=False, ge=-1e4, le=1e4)]
Length = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e4)]
Seconds = Annotated[float, Field(allow_inf_nan=False, ge=0.0)]
Point = tuple[Metres, Metres]

ALWAYS = (0.0, math.inf)
"""Since when and until when most things are there, seconds."""
WORLD_FOLDERS = (Path(__file__).parent / "worlds", Path(__file__).parents[2] / "datasets" / "worlds")
"""Where worlds are found by name: in an installed package, and in the source tree."""


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Thing(_Entry):
    """What can be seen, from `since` to before `until`, seconds after the start."""

    since: Seconds = 0.0
    until: Annotated[float, Field(gt=0.0)] = math.inf


class Wall(_Thing):
    """A straight wall with openings."""

    start: Point = Field(alias="from")
    end: Point = Field(alias="to")
    thickness: Annotated[float, Field(ge=0.0, le=5.0)] = 0.0
    doors: list[tuple[Metres, Length]] = []


class Box(_Thing):
    """A piece of furniture with four straight sides."""

    at: Point
    size: tuple[Length, Length]
    turn: Annotated[float, Field(ge=-360.0, le=360.0)] = 0.0


class Column(_Thing):
    """Anything round."""

    at: Point
    radius: Length


class WorldFile(_Entry):
    """What a world's file says."""

    title: str = ""
    speed: Annotated[float, Field(gt=0.0, le=3.0)] = 0.5
    path: Annotated[list[Point], Field(min_length=2)]
    walls: list[Wall] = []
    boxes: list[Box] = []
    columns: list[Column] = []


@dataclass(frozen=True, slots=True, eq=False)
class Passing:
    """What can be seen only from `since` to before `until`, seconds after the start; shapes as in `World`."""

    since: float
    until: float
    segments: Floats
    circles: Floats


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """What a lidar can see, and the way a robot takes.

    segments  (n, 4) x0 y0 x1 y1, metres, of what is always there
    circles   (m, 3) x y radius, metres, of what is always there
    path      (k, 2) way points, metres
    speed     metres a second
    passing   what is there for a time
    """

    name: str
    title: str
    segments: Floats
    circles: Floats
    path: Floats
    speed: float
    passing: tuple[Passing, ...] = ()

    def at(self, time: float) -> tuple[Floats, Floats]:
        """Segments and circles as they stand `time` seconds after the start."""
        there = [thing for thing in self.passing if thing.since <= time < thing.until]
        if not there:
            return self.segments, self.circles
        segments = np.concatenate([self.segments, *(thing.segments for thing in there)])
        return segments, np.concatenate([self.circles, *(thing.circles for thing in there)])


def world_names() -> list[str]:
    """The names of the worlds that come with the package."""
    return sorted({file.stem for folder in WORLD_FOLDERS for file in folder.glob("*.toml")})


def load_world(name: str | Path) -> World:
    """A world by its name, or from a TOML file; raises RecordingError where there is none or it is wrong."""
    path = _find(name)
    try:
        content = WorldFile.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except ValidationError as error:
        first = error.errors()[0]
        raise RecordingError(path, None, f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise RecordingError(path, None, f"is not a world: {error}") from error
    shapes = _shapes(content)
    if not shapes:
        raise RecordingError(path, None, "has no walls, boxes or columns")
    segments, circles = shapes.pop(ALWAYS, (np.zeros((0, 4)), np.zeros((0, 3))))
    return World(
        path.stem,
        content.title or path.stem,
        segments,
        circles,
        np.array(content.path, dtype=np.float64),
        content.speed,
        tuple(Passing(*span, *things) for span, things in sorted(shapes.items(), key=lambda item: item[0])),
    )


def _shapes(content: WorldFile) -> dict[tuple[float, float], tuple[Floats, Floats]]:
    """Segments (n, 4) and circles (m, 3) of a file, by the time during which they are there."""
    lines: dict[tuple[float, float], list[Segment]] = defaultdict(list)
    rounds: dict[tuple[float, float], list[tuple[float, float, float]]] = defaultdict(list)
    for wall in content.walls:
        lines[wall.since, wall.until] += _wall(wall)
    for box in content.boxes:
        lines[box.since, box.until] += _box(box)
    for column in content.columns:
        rounds[column.since, column.until].append((*column.at, column.radius))
    return {
        span: (
            np.array(lines.get(span, []), dtype=np.float64).reshape(-1, 4),
            np.array(rounds.get(span, []), dtype=np.float64).reshape(-1, 3),
        )
        for span in {**lines, **rounds}
    }


def _find(name: str | Path) -> Path:
    if Path(name).suffix == ".toml":
        if not Path(name).is_file():
            raise RecordingError(name, None, "no such world file")
        return Path(name)
    for folder in WORLD_FOLDERS:
        if (file := folder / f"{name}.toml").is_file():
            return file
    raise RecordingError(name, None, f"no such world; there are {', '.join(world_names())}, or give a .toml file")


Segment = tuple[float, float, float, float]


def _wall(wall: Wall) -> list[Segment]:
    """A wall's visible segments: lines, or the outlines of the pieces between its doors."""
    start, end = np.array(wall.start), np.array(wall.end)
    length = float(np.hypot(*(end - start)))
    heading = float(np.arctan2(*(end - start)[::-1]))
    half = wall.thickness / 2
    pieces: list[Segment] = []
    since = -half
    for begin, width in [*sorted(wall.doors), (length + half, 0.0)]:
        if begin > since:
            middle = se2.transform([*start, heading], [(since + begin) / 2, 0.0])
            pieces += _outline(middle, heading, begin - since, wall.thickness)
        since = max(since, begin + width)
    return pieces


def _box(box: Box) -> list[Segment]:
    return _outline(np.array(box.at), np.radians(box.turn), *box.size)


def _outline(middle: Floats, heading: float, length: float, width: float) -> list[Segment]:
    """The four sides of a rectangle, or one line where it has no width."""
    x, y = length / 2, width / 2
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)] if width > 0.0 else [(-x, 0.0), (x, 0.0)]
    placed = [(float(px), float(py)) for px, py in se2.transform([*middle, heading], corners)]
    following = placed[1:] + placed[:1] if width > 0.0 else placed[1:]
    return [(*a, *b) for a, b in zip(placed, following, strict=False)]
