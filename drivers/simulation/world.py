"""Worlds for the simulator: walls, doors, furniture and round columns, read from a TOML file.

    title = "one room with a box"
    speed = 0.5                                  # metres per second
    path = [[1, 1], [5, 1], [5, 3]]              # way points; the robot starts at the first

    [[walls]]
    from = [0, 0]
    to = [6, 0]
    thickness = 0.12                             # default 0
    doors = [[2.0, 0.9]]                         # openings: [start along the wall, width]

    [[boxes]]
    at = [3, 2]                                  # the centre
    size = [1.6, 0.8]
    turn = 15                                    # degrees, default 0

    [[columns]]
    at = [4, 4]
    radius = 0.25

A wall, box or column with `since` or `until` (seconds after the start) exists only during that time; thus furniture is
moved while the robot is elsewhere, and doors are closed.

Lengths are in metres. A wall with a thickness has two faces and the jambs of its doors; its centre line runs from
`from` to `to`, and both ends extend by half the thickness, so that walls meet in closed corners.
"""

from __future__ import annotations

import math
import tomllib
from collections import defaultdict
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from .. import se2
from ..errors import RecordingError
from ..immutable import immutable
from ..messages import Floats
from ..validation import first_problem

Metres = Annotated[float, Field(allow_inf_nan=False, ge=-1e4, le=1e4)]
Length = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e4)]
Seconds = Annotated[float, Field(allow_inf_nan=False, ge=0.0)]
Point = tuple[Metres, Metres]

ALWAYS = (0.0, math.inf)
"""(since, until) of permanent shapes, seconds."""
WORLD_FOLDERS = (Path(__file__).parent / "worlds", Path(__file__).parents[2] / "datasets" / "worlds")
"""Folders with the named worlds: in an installed package, and in the source tree."""


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Shape(_Entry):
    """Shape that exists from `since` to before `until`, seconds after the start."""

    since: Seconds = 0.0
    until: Annotated[float, Field(gt=0.0)] = math.inf


class Wall(_Shape):
    """Straight wall with openings."""

    start: Point = Field(alias="from")
    end: Point = Field(alias="to")
    thickness: Annotated[float, Field(ge=0.0, le=5.0)] = 0.0
    doors: list[tuple[Metres, Length]] = []


class Box(_Shape):
    """Rectangular piece of furniture."""

    at: Point
    size: tuple[Length, Length]
    turn: Annotated[float, Field(ge=-360.0, le=360.0)] = 0.0


class Column(_Shape):
    """Round column."""

    at: Point
    radius: Length


class WorldFile(_Entry):
    """Content of a world file."""

    title: str = ""
    speed: Annotated[float, Field(gt=0.0, le=3.0)] = 0.5
    path: Annotated[list[Point], Field(min_length=2)]
    walls: list[Wall] = []
    boxes: list[Box] = []
    columns: list[Column] = []


@immutable
class TemporaryShapes:
    """Shapes that exist from `since` to before `until`, seconds after the start; arrays as in `World`."""

    since: float
    until: float
    segments: Floats
    circles: Floats


@immutable
class World:
    """Building in which the simulated robot drives, and the way points of the drive.

    segments   (n, 4) x0 y0 x1 y1, metres, of permanent shapes
    circles    (m, 3) x y radius, metres, of permanent shapes
    waypoints  (k, 2) metres
    speed      metres per second
    temporary  shapes that exist for a time
    """

    name: str
    title: str
    segments: Floats
    circles: Floats
    waypoints: Floats
    speed: float
    temporary: tuple[TemporaryShapes, ...] = ()

    def shapes_at(self, time: float) -> tuple[Floats, Floats]:
        """Return the segments (n, 4) and circles (m, 3) that exist `time` seconds after the start."""
        present = [shapes for shapes in self.temporary if shapes.since <= time < shapes.until]
        if not present:
            return self.segments, self.circles
        segments = np.concatenate([self.segments, *(shapes.segments for shapes in present)])
        return segments, np.concatenate([self.circles, *(shapes.circles for shapes in present)])


def world_names() -> list[str]:
    """Return the names of the worlds that come with the package."""
    return sorted({file.stem for folder in WORLD_FOLDERS for file in folder.glob("*.toml")})


def load_world(name: str | Path) -> World:
    """Load a world by its name or from a TOML file; raises RecordingError if it does not exist or is invalid."""
    return build_world(_find(name).stem, load_world_file(name))


def load_world_file(name: str | Path) -> WorldFile:
    """Load the content of a world's file; raises RecordingError as `load_world` does."""
    path = _find(name)
    try:
        content = WorldFile.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except ValidationError as error:
        raise RecordingError(path, None, first_problem(error)) from error
    except (OSError, ValueError, RecursionError) as error:
        raise RecordingError(path, None, f"is not a valid world file: {error}") from error
    if not (content.walls or content.boxes or content.columns):
        raise RecordingError(path, None, "has no walls, boxes or columns")
    return content


def build_world(name: str, content: WorldFile) -> World:
    """Return the world that a file's content describes."""
    shapes = _shapes(content)
    segments, circles = shapes.pop(ALWAYS, (np.zeros((0, 4)), np.zeros((0, 3))))
    return World(
        name,
        content.title or name,
        segments,
        circles,
        np.array(content.path, dtype=np.float64),
        content.speed,
        tuple(TemporaryShapes(*span, *arrays) for span, arrays in sorted(shapes.items(), key=lambda item: item[0])),
    )


def _shapes(content: WorldFile) -> dict[tuple[float, float], tuple[Floats, Floats]]:
    """Return the segments (n, 4) and circles (m, 3) of a file, keyed by their (since, until)."""
    lines: dict[tuple[float, float], list[Segment]] = defaultdict(list)
    circles: dict[tuple[float, float], list[tuple[float, float, float]]] = defaultdict(list)
    for wall in content.walls:
        lines[wall.since, wall.until] += _wall_segments(wall)
    for box in content.boxes:
        lines[box.since, box.until] += _box_segments(box)
    for column in content.columns:
        circles[column.since, column.until].append((*column.at, column.radius))
    return {
        span: (
            np.array(lines.get(span, []), dtype=np.float64).reshape(-1, 4),
            np.array(circles.get(span, []), dtype=np.float64).reshape(-1, 3),
        )
        for span in {**lines, **circles}
    }


def _find(name: str | Path) -> Path:
    if Path(name).suffix == ".toml":
        if not Path(name).is_file():
            raise RecordingError(name, None, "no such world file")
        return Path(name)
    for folder in WORLD_FOLDERS:
        if (file := folder / f"{name}.toml").is_file():
            return file
    raise RecordingError(name, None, f"no such world; choose one of {', '.join(world_names())}, or a .toml file")


Segment = tuple[float, float, float, float]


def _wall_segments(wall: Wall) -> list[Segment]:
    """Return a wall's visible segments: lines, or the outlines of the pieces between its doors."""
    start, end = np.array(wall.start), np.array(wall.end)
    length = float(np.hypot(*(end - start)))
    heading = float(np.arctan2(*(end - start)[::-1]))
    half = wall.thickness / 2
    pieces: list[Segment] = []
    piece_start = -half
    for begin, width in [*sorted(wall.doors), (length + half, 0.0)]:
        if begin > piece_start:
            middle = se2.transform([*start, heading], [(piece_start + begin) / 2, 0.0])
            pieces += _outline(middle, heading, begin - piece_start, wall.thickness)
        piece_start = max(piece_start, begin + width)
    return pieces


def _box_segments(box: Box) -> list[Segment]:
    return _outline(np.array(box.at), np.radians(box.turn), *box.size)


def _outline(middle: Floats, heading: float, length: float, width: float) -> list[Segment]:
    """Return the four sides of a rectangle, or a single segment if its width is zero."""
    x, y = length / 2, width / 2
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)] if width > 0.0 else [(-x, 0.0), (x, 0.0)]
    vertices = [(float(px), float(py)) for px, py in se2.transform([*middle, heading], corners)]
    following = vertices[1:] + vertices[:1] if width > 0.0 else vertices[1:]
    return [(*a, *b) for a, b in zip(vertices, following, strict=False)]
