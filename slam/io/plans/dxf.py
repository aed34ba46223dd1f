"""Read the lines of a DXF drawing with ezdxf: LINE, LWPOLYLINE and POLYLINE, also those of inserted blocks."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ...errors import MapError, first_line
from ...extras import require_extra
from ...geometry.segments import Floats
from ..exports.dxf import OWN_APPLICATION
from .drawing import Drawing, polyline

if TYPE_CHECKING:
    from ezdxf.document import Drawing as Document
    from ezdxf.entities import DXFEntity

OWN_LAYER = "WALLS"
"""Layer of walls in the drawings that `wclm map` and `wclm measure` write."""
DAMAGE = (ArithmeticError, AttributeError, LookupError, RecursionError, StopIteration, TypeError, ValueError)
"""Errors of ezdxf at damaged files, besides its own."""


def read_dxf(path: Path, layers: Sequence[str] = ()) -> Drawing:
    """Read a drawing; with `layers`, only these. Layers that are switched off or frozen are left out.

    Raises MapError naming the file and the problem, and MissingExtraError without ezdxf.
    """
    require_extra("plans")
    document = _open(path)
    own = OWN_APPLICATION in document.appids
    names = {layer.dxf.name.lower(): layer for layer in document.layers}
    unknown = [name for name in layers if name.lower() not in names]
    if unknown:
        known = ", ".join(sorted(layer.dxf.name for layer in document.layers))
        raise MapError(f"{path}: has no layer {unknown[0]}; its layers are {known}")
    chosen = {name.lower() for name in layers} or ({OWN_LAYER.lower()} if own else None)
    hidden = {name for name, layer in names.items() if layer.is_off() or layer.is_frozen()}
    lines: list[Floats] = []
    left_out: Counter[str] = Counter()
    for entity in _entities(path, document):
        layer = str(entity.dxf.get("layer", "0")).lower()
        if layer in hidden or (chosen is not None and layer not in chosen):
            continue
        line = _line_of(entity)
        if line is None:
            left_out[entity.dxftype()] += 1
        else:
            lines.append(line)
    return Drawing(lines, own, _unit_of(document), dict(left_out))


def _open(path: Path) -> Document:
    import ezdxf

    logging.getLogger("ezdxf").setLevel(logging.CRITICAL)  # else what it ignores in tables is printed on the terminal
    try:
        return ezdxf.readfile(path)
    except OSError as error:
        raise MapError(f"{path}: {error.strerror or 'is not a DXF file'}") from error
    except (ezdxf.DXFError, *DAMAGE) as error:
        raise MapError(f"{path}: is not a valid DXF file: {first_line(error)}") from error


def _entities(path: Path, document: Document) -> Iterator[DXFEntity]:
    """Yield the entities of the model space, with those of blocks where they are inserted."""
    import ezdxf
    from ezdxf.disassemble import recursive_decompose

    try:
        yield from recursive_decompose(document.modelspace())
    except (ezdxf.DXFError, *DAMAGE) as error:
        raise MapError(f"{path}: is not a valid DXF file: {first_line(error)}") from error


def _line_of(entity: DXFEntity) -> Floats | None:
    """Return the points (k, 2) of a line or polyline; arcs of polylines become chords. None for other entities."""
    from ezdxf.entities import Line, LWPolyline, Polyline

    if isinstance(entity, Line):
        return polyline([tuple(entity.dxf.start), tuple(entity.dxf.end)])
    if isinstance(entity, LWPolyline):
        return polyline([tuple(point) for point in entity.vertices_in_wcs()], closed=entity.closed)
    if isinstance(entity, Polyline) and (entity.is_2d_polyline or entity.is_3d_polyline):
        return polyline([tuple(point) for point in entity.points_in_wcs()], closed=entity.is_closed)
    return None


def _unit_of(document: Document) -> float | None:
    """Return the metres per unit by $INSUNITS; None if the drawing states none."""
    import ezdxf
    from ezdxf import units

    if document.header.get("$INSUNITS", 0) == 0:
        return None
    try:
        return float(units.conversion_factor(units.InsertUnits(document.header["$INSUNITS"]), units.InsertUnits.Meters))
    except (ezdxf.DXFError, ValueError, LookupError):  # a unit that ezdxf does not know
        return None
