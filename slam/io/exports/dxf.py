"""Write the map as a DXF drawing of AutoCAD 2000 with ezdxf.

One drawing unit is a metre, as $INSUNITS states. Each observed piece of a wall is a LINE on the layer WALLS, each
corner a POINT on CORNERS, and the driven path an LWPOLYLINE on PATH. Of a measured map, outlines and islands of rooms
are closed LWPOLYLINEs on ROOMS with a TEXT of name and area, doors and passages LINEs on OPENINGS with a TEXT of name
and width, and measurements aligned DIMENSIONs on DIMENSIONS, in the dimension style METRES.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...extras import require_extra
from ...geometry.segments import Floats
from ...measuring.measured_map import NOTHING_MEASURED, MeasuredMap
from ..run_results import RunResults
from .dimension_lines import AREA_TEXT_HEIGHT, TEXT_GAP, TEXT_HEIGHT, DimensionLine, opening_text
from .path_thinning import thin_path
from .text_placement import placed_areas, placed_dimensions

if TYPE_CHECKING:
    from ezdxf.document import Drawing
    from ezdxf.layouts import Modelspace

LAYERS = {"WALLS": (7, 50), "CORNERS": (1, 18), "PATH": (5, 18)}
"""Layers, their colour numbers (black or white, red, blue), and the widths of their lines in 1/100 mm of paper."""
MEASURED_LAYERS = {"ROOMS": (3, 18), "OPENINGS": (4, 25), "DIMENSIONS": (8, 13)}
"""The same of a measured map: green, cyan, grey."""
OWN_APPLICATION = "WCLM_SLAM"
"""Registered application (APPID) by which drawings of this project are recognised if they are read as plans."""
DIMENSION_STYLE = "METRES"
DIMENSIONS = {
    "dimtxt": TEXT_HEIGHT,
    "dimtsz": 0.06,  # oblique strokes instead of arrows
    "dimasz": 0.06,
    "dimgap": TEXT_GAP * TEXT_HEIGHT,
    "dimexo": 0.0,
    "dimexe": 0.0,
    "dimclrd": 8,  # lines grey, the text black or white
    "dimclre": 8,
    "dimclrt": 7,
    "dimtad": 1,  # text above the line
    "dimtih": 0,  # text along the line
    "dimtoh": 0,
    "dimlunit": 2,  # decimal
    "dimdec": 3,
    "dimzin": 0,  # all three decimals
    "dimdsep": ord("."),
    "dimscale": 1.0,
}
"""Variables of the dimension style; lengths in metres."""


def write_dxf(path: Path, results: RunResults, measured: MeasuredMap = NOTHING_MEASURED) -> None:
    """Write walls, corners and path, and rooms, openings and dimensions of a measured map.

    Raises MissingExtraError without ezdxf.
    """
    require_extra("plans")
    import ezdxf
    from ezdxf import units

    with _same_output():
        document = ezdxf.new("R2000", units=units.M)
        document.appids.add(OWN_APPLICATION)
        layers = LAYERS | (MEASURED_LAYERS if measured is not NOTHING_MEASURED else {})
        for name, (colour, line_width) in layers.items():
            document.layers.add(name, color=colour, lineweight=line_width)
        style = document.dimstyles.new(DIMENSION_STYLE, dxfattribs=DIMENSIONS)
        style.copy_to_header(document)  # for programs without dimension styles, and as the current style
        _set_view(document, results)
        space = document.modelspace()
        _add_rooms(space, measured)
        _add_map(space, results)
        _add_openings(space, measured)
        for line, place in placed_dimensions(measured):
            _add_dimension(space, line, place)
        document.saveas(path)


@contextmanager
def _same_output() -> Iterator[None]:
    """Let ezdxf write fixed dates and identifiers, so that the same map gives the same file."""
    import ezdxf

    before = ezdxf.options.write_fixed_meta_data_for_testing
    ezdxf.options.write_fixed_meta_data_for_testing = True
    try:
        yield
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = before


def _set_view(document: Drawing, results: RunResults) -> None:
    """Show the whole map if the drawing is opened."""
    drawn = np.concatenate([results.walls.end_points().reshape(-1, 2), results.trajectory.poses[:, :2]])
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    document.modelspace().reset_extents((*low.tolist(), 0.0), (*high.tolist(), 0.0))
    width, height = (high - low).tolist()
    document.set_modelspace_vport(1.1 * max(height, 0.5 * width, 1.0), (0.5 * (low + high)).tolist())


def _add_map(space: Modelspace, results: RunResults) -> None:
    for start, end in results.walls.piece_points()[0]:
        space.add_line(_point(start), _point(end), {"layer": "WALLS"})
    for position in results.corners.position:
        space.add_point(_point(position), {"layer": "CORNERS"})
    for drive in results.drives():
        points = drive.poses[thin_path(drive.poses), :2]
        space.add_lwpolyline([_point(p) for p in points], dxfattribs={"layer": "PATH"})


def _add_rooms(space: Modelspace, measured: MeasuredMap) -> None:
    for room in measured.rooms:
        for part in (room.outline, *room.islands):
            space.add_lwpolyline([_point(p) for p in part.vertices], close=True, dxfattribs={"layer": "ROOMS"})
    for place, text in placed_areas(measured):
        _add_text(space, "ROOMS", place, text, AREA_TEXT_HEIGHT)


def _add_openings(space: Modelspace, measured: MeasuredMap) -> None:
    for opening in measured.openings:
        space.add_line(_point(opening.ends[0]), _point(opening.ends[1]), {"layer": "OPENINGS"})
        place, text, angle = opening_text(opening)
        _add_text(space, "OPENINGS", place, text, TEXT_HEIGHT, angle)


def _add_dimension(space: Modelspace, line: DimensionLine, place: Floats) -> None:
    """Add an aligned dimension, its text above a place (2,) of the line, with its picture, which programs show."""
    direction = np.array([np.cos(line.angle), np.sin(line.angle)])
    start, end = sorted(line.measured, key=lambda point: float(point @ direction))  # else the text is upside down
    left = np.array([-direction[1], direction[0]])
    dimension = space.add_aligned_dim(
        _point(start),
        _point(end),
        distance=float(left @ (line.line[0] - line.measured[0])),
        text=line.text,
        dimstyle=DIMENSION_STYLE,
        dxfattribs={"layer": "DIMENSIONS"},
    )
    if shift := round(float((place - line.middle) @ direction), 6):
        dimension.shift_text(shift, 0.0)
    dimension.render()


def _add_text(space: Modelspace, layer: str, middle: Floats, text: str, height: float, angle: float = 0.0) -> None:
    """Add a text centred above a place, in a direction in radians."""
    from ezdxf.enums import TextEntityAlignment

    attributes = {"layer": layer, "rotation": float(np.degrees(angle))}
    entity = space.add_text(text, height=height, dxfattribs=attributes)
    entity.set_placement(_point(middle), align=TextEntityAlignment.BOTTOM_CENTER)


def _point(position: Floats) -> tuple[float, float]:
    """Return a point (2,), rounded to micrometres; adding zero turns -0.0 into 0.0."""
    x, y = (np.round(position, 6) + 0.0).tolist()
    return x, y
