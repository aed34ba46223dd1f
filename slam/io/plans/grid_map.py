"""Read the walls of a grid map of ROS (map_server): a PGM or PNG picture and its YAML file.

The border between occupied and free cells is followed, with the free cells on its left, and divided into straight
pieces. A wall is somewhere in the occupied cells at the border: lines are fitted to their centres, whose error is
uniform over a cell.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from scipy.ndimage import binary_closing, binary_dilation, distance_transform_edt

from drivers import se2
from drivers.immutable import immutable

from ...errors import MapError, first_line
from ...extras import require_extra
from ...geometry.segments import Floats
from ...mapping.plan import Plan

MAX_PIXELS = 400_000_000
"""Largest picture."""
SPLIT_DISTANCE = 1.5
"""Cells between the border and a line above which the line is divided: staircases and noise of a cell stay together."""
VIEWPOINT_SPACING = 1.0
"""Metres between places in free space."""
VIEWPOINT_CLEARANCE = 0.3
"""Metres of free space around such a place."""
HEADER = re.compile(rb"(P[25])(?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s")
"""Header of a PGM picture: format, width, height, largest value; comments begin with #."""

Cells = NDArray[np.bool_]


@immutable
class GridMap:
    """Occupied and free cells (rows, columns), the first row at the lowest y; the others are unknown.

    resolution  side of a cell, metres
    origin      (3,) pose [x, y, heading] of the corner of the first cell
    """

    occupied: Cells
    free: Cells
    resolution: float
    origin: se2.Pose

    def to_metres(self, points: Floats) -> Floats:
        """Return points (..., 2) [column, row] in metres in the map; (0, 0) is the corner of the first cell."""
        return np.asarray(se2.transform(self.origin, self.resolution * points))


def read_grid_map(path: Path) -> Plan:
    """Read a grid map by its YAML file, or by its picture with a YAML file of the same name beside it.

    Raises MapError naming the file and the problem; MissingExtraError for a PNG picture without Pillow.
    """
    grid = load_grid_map(path)
    segments = grid.to_metres(_straight_pieces(grid)).reshape(-1, 2, 2)
    precision = grid.resolution / math.sqrt(12.0)
    return Plan(path.name, segments, np.ones(len(segments), dtype=bool), precision, _viewpoints(grid))


def load_grid_map(path: Path) -> GridMap:
    """Load the cells of a grid map; errors as in `read_grid_map`."""
    described = path if path.suffix.lower() in (".yaml", ".yml") else _description_of(path)
    values = _read_description(described)
    if not isinstance(name := values["image"], str) or not name.isprintable():
        raise MapError(f"{described}: image is no name of a file")
    picture = described.parent / name
    if picture.exists() and not picture.is_file():  # a device or a pipe might never end
        raise MapError(f"{picture}: is not a file")
    pixels = _read_picture(picture)
    resolution, origin = _number(described, values, "resolution"), values["origin"]
    occupied_threshold = _number(described, values, "occupied_thresh", 0.65)
    free_threshold = _number(described, values, "free_thresh", 0.196)
    if resolution <= 0.0:
        raise MapError(f"{described}: resolution must be positive")
    if not isinstance(origin, list) or len(origin) != 3 or not all(isinstance(v, int | float) for v in origin):
        raise MapError(f"{described}: origin must be three numbers, x, y and heading")
    if not np.isfinite(pose := np.array(origin, dtype=np.float64)).all():
        raise MapError(f"{described}: origin is not finite")
    occupancy = pixels if values.get("negate", 0) else 1.0 - pixels
    return GridMap(occupancy > occupied_threshold, occupancy < free_threshold, resolution, pose)


def _description_of(picture: Path) -> Path:
    """Return the YAML file of a picture. Raises MapError if there is none."""
    for suffix in (".yaml", ".yml"):
        if (beside := picture.with_suffix(suffix)).is_file():
            return beside
    raise MapError(f"{picture}: needs {picture.with_suffix('.yaml').name} beside it, which states the size of a cell")


def _read_description(path: Path) -> dict[str, Any]:
    """Read a YAML file with image, resolution and origin. Raises MapError."""
    try:
        values = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    except (YAMLError, ValueError, RecursionError) as error:
        raise MapError(f"{path}: is not valid YAML: {first_line(error)}") from error
    for name in ("image", "resolution", "origin"):
        if not isinstance(values, dict) or name not in values:
            raise MapError(f"{path}: is not the description of a grid map: it has no {name}")
    return dict(values)


def _number(path: Path, values: dict[str, Any], name: str, default: float | None = None) -> float:
    """Return a number of a description. Raises MapError."""
    value = values.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise MapError(f"{path}: {name} is no number")
    return float(value)


def _read_picture(path: Path) -> Floats:
    """Return the grey values (rows, columns) of a picture, 0 to 1, the last row first. Raises MapError."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or error}") from error
    pixels = _pgm_pixels(path, content) if content[:2] in (b"P5", b"P2") else _pixels_of_other(path)
    return np.asarray(pixels[::-1])


def _pgm_pixels(path: Path, content: bytes) -> Floats:
    """Return the grey values of a PGM picture, binary or as text. Raises MapError."""
    header = HEADER.match(content)
    if header is None:
        raise MapError(f"{path}: is not a valid PGM picture")
    width, height, largest = (int(header.group(k)) for k in (2, 3, 4))
    if not 0 < width * height <= MAX_PIXELS or not 0 < largest < 1 << 16:
        raise MapError(f"{path}: has {width} x {height} pixels with values up to {largest}")
    try:
        if header.group(1) == b"P2":
            values = np.array(content[header.end() :].split()[: width * height], dtype=np.float64)
        else:
            kind = np.dtype(np.uint8 if largest < 256 else ">u2")
            values = np.frombuffer(content, kind, width * height, header.end()).astype(np.float64)
        return np.asarray(values.reshape(height, width) / largest)
    except ValueError as error:
        raise MapError(f"{path}: is cut off: it has fewer than {width} x {height} pixels") from error


def _pixels_of_other(path: Path) -> Floats:
    """Return the grey values of a PNG picture; transparent pixels are unknown. Raises MapError."""
    require_extra("plans")
    from PIL import Image

    try:
        with Image.open(path) as picture:
            if picture.width * picture.height > MAX_PIXELS:
                raise MapError(f"{path}: has {picture.width} x {picture.height} pixels")
            return np.asarray(picture.convert("L"), dtype=np.float64) / 255.0
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise MapError(f"{path}: is not a picture: {first_line(error)}") from error


# --- places in free space


def _viewpoints(grid: GridMap) -> Floats:
    """Return the place with most free space around it in each square of VIEWPOINT_SPACING, if that is enough."""
    clearance: Floats = grid.resolution * np.asarray(distance_transform_edt(grid.free), dtype=np.float64)
    rows, columns = np.nonzero(clearance >= VIEWPOINT_CLEARANCE)
    # A square larger than the map is the whole map, however many cells that would be.
    side = max(1, round(min(VIEWPOINT_SPACING / grid.resolution, float(max(grid.free.shape)))))
    square = (rows // side) * (grid.free.shape[1] // side + 1) + columns // side
    order = np.lexsort((-clearance[rows, columns], square))
    first = order[np.flatnonzero(np.diff(square[order], prepend=-1))]
    cells = np.column_stack([columns[first], rows[first]]).astype(np.float64)
    return grid.to_metres(cells + 0.5).reshape(-1, 2)


# --- straight pieces of the border


def _straight_pieces(grid: GridMap) -> Floats:
    """Return the end points (n, 2, 2) [column, row] of straight pieces of the border, free space on their left.

    Cells that are on no line are pieces too, one for each of their free sides, through their centres.
    """
    # Beams of both sides of a thin wall end in its cells and pass through their edges, so that some are unknown.
    occupied = grid.occupied | (binary_closing(grid.occupied, np.ones((3, 3), dtype=bool)) & ~grid.free)
    # Where a wall is on the border of two cells, beams end in both, and the nearer one is often unknown.
    free = grid.free | (binary_dilation(grid.free) & ~occupied)
    pieces = []
    for centres, steps in _chains(occupied, free):
        for part in _split(centres):
            fitted = _fit(centres[part])
            if math.hypot(*(fitted[1] - fitted[0])) >= 1.0:
                pieces.append(fitted[None])
            else:
                pieces.append(np.stack([centres[part] - 0.5 * steps[part], centres[part] + 0.5 * steps[part]], axis=1))
    return np.concatenate([np.zeros((0, 2, 2)), *pieces])


def _chains(occupied: Cells, free: Cells) -> Iterator[tuple[Floats, Floats]]:
    """Yield centres and directions (k, 2) [column, row] of occupied cells along each border with free cells.

    A border consists of edges of cells, which are followed from corner to corner. At a corner where four edges meet,
    the one to the right is taken: occupied cells that touch there are one wall.
    """
    starts, ends, cells = _edges(occupied, free)
    leaving: dict[tuple[int, int], list[int]] = {}
    for edge, start in enumerate(map(tuple, starts.tolist())):
        leaving.setdefault(start, []).append(edge)
    arrived = set(map(tuple, ends.tolist()))
    used = np.zeros(len(starts), dtype=bool)
    first_of_open = [edge for edge, start in enumerate(map(tuple, starts.tolist())) if start not in arrived]
    for begin in [*first_of_open, *range(len(starts))]:
        chain, edge = list[int](), begin
        while not used[edge]:
            used[edge] = True
            chain.append(edge)
            onward = [k for k in leaving.get(tuple(ends[edge].tolist()), ()) if not used[k]]
            if not onward:
                break
            edge = min(onward, key=lambda k: _turn(ends[edge] - starts[edge], ends[k] - starts[k]))
        if chain:
            yield cells[chain].astype(np.float64) + 0.5, (ends[chain] - starts[chain]).astype(np.float64)


def _turn(before: NDArray[np.int64], after: NDArray[np.int64]) -> int:
    """Return the sine of the angle from one edge to the next one: negative to the right."""
    return int(before[0] * after[1] - before[1] * after[0])


def _edges(occupied: Cells, free: Cells) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return start and end (n, 2) of the edges between occupied and free cells, and their occupied cells (n, 2).

    All are [column, row]; the free cell is on the left.
    """
    around = np.pad(free, 1)
    parts = []
    for dx, dy, start, end in (
        (0, 1, (0, 1), (1, 1)),
        (0, -1, (1, 0), (0, 0)),
        (1, 0, (1, 1), (1, 0)),
        (-1, 0, (0, 0), (0, 1)),
    ):
        rows, columns = np.shape(occupied)
        rows_of, columns_of = np.nonzero(occupied & around[1 + dy : 1 + dy + rows, 1 + dx : 1 + dx + columns])
        cell = np.column_stack([columns_of, rows_of])
        parts.append((cell + start, cell + end, cell))
    starts, ends, cells = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return starts, ends, cells


def _split(points: Floats) -> list[slice]:
    """Divide a chain of points where it is farthest from the chord, until all are near (Ramer 1972)."""
    result, waiting = [], [slice(0, len(points))]
    while waiting:
        rows = waiting.pop()
        part = points[rows]
        chord = part[-1] - part[0]
        length = math.hypot(*chord)
        from_start = part - part[0]
        if length > 0.0:
            distance = np.abs(chord[0] * from_start[:, 1] - chord[1] * from_start[:, 0]) / length
        else:
            distance = np.hypot(from_start[:, 0], from_start[:, 1])
        farthest = int(distance.argmax())
        if distance[farthest] <= SPLIT_DISTANCE or not 0 < farthest < len(part) - 1:
            result.append(rows)
        else:
            waiting += [slice(rows.start + farthest, rows.stop), slice(rows.start, rows.start + farthest + 1)]
    return result


def _fit(points: Floats) -> Floats:
    """Return both ends (2, 2) of the line through points (k, 2) with the least squared distances, in their order."""
    middle = points.mean(axis=0)
    axis = np.linalg.svd(points - middle, full_matrices=False)[2][0]  # of a single point any axis
    along = (points - middle) @ axis
    if along[-1] < along[0]:
        axis, along = -axis, -along
    return np.asarray(middle + np.array([along.min(), along.max()])[:, None] * axis)
