"""Read a plan in any of the supported formats."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import MapError
from ...mapping.plan import Plan
from .drawing import DRAWING_PRECISION, Drawing, to_segments
from .dxf import read_dxf
from .earlier_map import read_earlier_map
from .geojson import read_geojson
from .grid_map import read_grid_map
from .svg import read_svg
from .units import METRES, Unit

DRAWINGS = {".dxf": read_dxf, ".geojson": read_geojson, ".json": read_geojson, ".svg": read_svg}
GRID_SUFFIXES = (".yaml", ".yml", ".pgm", ".png")
PLAN_SUFFIXES = (*DRAWINGS, *GRID_SUFFIXES)
"""Suffixes of files that are read as plans."""
MIN_PIECE = 0.05
"""Metres below which a piece of a line shows no wall: flattened curves and hatching consist of such pieces."""
MAX_EXTENT = 5000.0
"""Metres: a larger plan is in the wrong unit."""
MIN_EXTENT = 1.0
"""Metres: a smaller plan is in the wrong unit."""

MAX_LINES = 50_000
"""Lines of a drawing: with more, finding what can be seen of them takes many minutes. Floors of large buildings have
some thousand walls; more lines are furniture, hatching and text."""


def is_plan_file(path: Path) -> bool:
    """Return True if a path names a file that is read as a plan, and not the output directory of a run."""
    return not path.is_dir() and path.suffix.lower() in PLAN_SUFFIXES


def read_plan(path: Path, unit: Unit | None = None, layers: Sequence[str] = ()) -> Plan:
    """Read a plan: a DXF, GeoJSON or SVG drawing, a grid map of ROS, or the output directory of an earlier run.

    unit    of a drawing; if None, the one that the file states, else metres
    layers  names of the layers of a DXF drawing that contain the walls; all if there is none

    Raises MapError naming the file and the problem; MissingExtraError if a package for the format is not installed.
    """
    suffix = path.suffix.lower()
    if path.is_dir():
        plan = read_earlier_map(path)
    elif suffix in GRID_SUFFIXES:
        plan = read_grid_map(path)
    elif suffix in DRAWINGS:
        if layers and suffix != ".dxf":
            raise MapError(f"{path}: only DXF drawings have layers to choose from")
        drawing = read_dxf(path, layers) if suffix == ".dxf" else DRAWINGS[suffix](path)
        plan = _to_plan(path, drawing, unit)
    else:
        known = ", ".join(PLAN_SUFFIXES)
        raise MapError(f"{path}: is no plan: neither the output directory of a run nor a file with one of {known}")
    if not len(plan.segments):
        raise MapError(f"{path}: has no straight line of {MIN_PIECE:g} m or more, so no wall")
    return plan


def _to_plan(path: Path, drawing: Drawing, unit: Unit | None) -> Plan:
    """Return a drawing in metres. Raises MapError if its coordinates are not finite, its size is wrong, or it has too
    many lines."""
    scale = METRES[unit] if unit is not None else drawing.unit or 1.0
    segments = scale * to_segments(drawing.lines)
    if not np.isfinite(segments).all():
        raise MapError(f"{path}: a coordinate is not finite")
    if len(segments):
        width, height = (segments.max(axis=(0, 1)) - segments.min(axis=(0, 1))).tolist()
        if not MIN_EXTENT <= max(width, height) <= MAX_EXTENT:
            of_globe = max(width, height) < MIN_EXTENT and DRAWINGS[path.suffix.lower()] is read_geojson
            degrees = "; degrees of longitude and latitude are not read" if of_globe else ""
            size = _size(width, height)
            raise MapError(f"{path}: would be {size}; state the unit of the drawing with --plan-unit{degrees}")
    segments = segments[np.hypot(*(segments[:, 1] - segments[:, 0]).T) >= MIN_PIECE]
    if len(segments) > MAX_LINES:
        raise MapError(
            f"{path}: has {len(segments)} lines, more than {MAX_LINES}; export the walls alone, or choose their layers "
            "in a DXF drawing with --plan-layer"
        )
    notes = []
    if unit is None and drawing.unit is None and len(segments):
        notes.append(f"states no unit and is read in metres: {_size(width, height)} (--plan-unit sets another one)")
    if drawing.left_out:
        named = ", ".join(f"{count} {name}" for name, count in sorted(drawing.left_out.items()))
        notes.append(f"left out, as they are no straight lines: {named}")
    return Plan(path.name, segments, np.full(len(segments), drawing.one_sided), DRAWING_PRECISION, notes=[*notes])


def _size(width: float, height: float) -> str:
    """Return a size (metres) as text."""
    return f"{width:.3g} m x {height:.3g} m"
