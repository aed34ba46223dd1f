"""The changes between two maps as text, GeoJSON and a picture."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from drivers import se2

from ...geometry.segments import Floats
from ...io.exports.scale_bar import SCALE_BAR_STYLE, draw_scale_bar
from ...measuring.wall_map import WallGeometry
from .changes import DIFFERENCES, Change, ChangeKind, MapDiff
from .corners import CornerChange

STYLE = """
path { fill: none; stroke-linecap: round }
.same { stroke: #b0b7bf }
.unseen { stroke: #b0b7bf }
.old { stroke: #d55e00 }
.new { stroke: #0072b2 }
text { fill: #1f2933 }
"""
"""Orange is only in the old map, blue only in the new one: distinguishable if colour-blind."""
LEAST_PROBABILITY = 1e-99
"""Least p-value that is printed."""
MARGIN = 1.0
"""Metres around the drawing."""
MILLIMETRES_PER_METRE, PAGE = 10.0, 250.0
"""Millimetres of paper per metre of the map, and of the longer side of the drawing at most."""
STROKE, TEXT = 1.0 / 400.0, 1.0 / 80.0
"""Width of lines and size of text, as shares of the longer side of the drawing."""
DOT_SPACING = 2.5
"""Distance between the dots of walls that only one of the drives has seen, in widths of a line."""
LEAST_STROKE, LEAST_TEXT = 0.06, 0.3
"""The least of both, metres of the map."""


def diff_text(diff: MapDiff, corners: Sequence[CornerChange]) -> str:
    """Return a line for each difference, then those that were not seen, and the number of walls in both maps."""
    lines = difference_lines(diff)
    for kind in DIFFERENCES:
        identities = [str(corner.identity) for corner in corners if corner.kind is kind]
        if identities:
            lines.append(f"corners {kind}: {', '.join(identities)}")
    for kind in (ChangeKind.NOT_SEEN_AGAIN, ChangeKind.NOT_SEEN_BEFORE):
        walls = [str(_named(change)) for change in diff.changes if change.kind is kind]
        if walls:
            lines.append(f"{kind}, which proves nothing: walls {', '.join(walls)}")
    same = f"{diff.same} walls are the same ({diff.tests} statistical tests)"
    if not lines:
        same = f"no wall has moved, is gone or is new; {same}"
    return "\n".join([*lines, same if math.isclose(diff.scale, 1.0) else f"{same}, variances times {diff.scale:.2f}"])


def difference_lines(diff: MapDiff) -> list[str]:
    """Return a line for each wall that has moved, is gone or is new, with its place and the size of the difference."""
    return [_line(change) for change in diff.changes if change.kind in DIFFERENCES]


def _line(change: Change) -> str:
    if change.kind is ChangeKind.MOVED:
        shift, turn = 1e3 * change.shift, math.degrees(change.turn)
        side = "left" if shift > 0.0 else "right"
        sigmas = 1e3 * change.sigma[0], math.degrees(change.sigma[1])
        which = f"wall {change.old}, now {change.new}, {_place(change)}"
        text = f"{which}: {abs(shift):.1f} mm ± {sigmas[0]:.1f} mm to its {side}"
        return f"moved: {text}, turned by {turn:.2f}° ± {sigmas[1]:.2f}°, {_probability(change)}"
    if change.kind is ChangeKind.END_MOVED:
        (x0, y0), (x1, y1) = change.stretches[0].tolist()
        which = f"of wall {change.old}, now {change.new}, from ({x0:.2f}, {y0:.2f}) to ({x1:.2f}, {y1:.2f})"
        by = "longer" if change.shift > 0.0 else "shorter"
        text = f"{by} by {1e3 * abs(change.shift):.0f} mm ± {1e3 * change.sigma[0]:.0f} mm"
        return f"end moved: {which}: {text}, {_probability(change)}"
    length = math.hypot(*(change.stretches[0, 1] - change.stretches[0, 0]))
    place = f"{length:.1f} m of wall {_named(change)} {_place(change)}"
    votes = f"seen through by {change.through} scans, seen by {change.seen}"
    return f"{change.kind}: {place}, {votes}, {_probability(change)}"


def _place(change: Change) -> str:
    """Return the ends of a wall, or of the stretch that a change is about, as text."""
    (x0, y0), (x1, y1) = change.stretches[0, 0].tolist(), change.stretches[-1, 1].tolist()
    return f"from ({x0:.2f}, {y0:.2f}) to ({x1:.2f}, {y1:.2f})"


def _probability(change: Change) -> str:
    """Return the p-value as text; beyond any sensible digit only that it is smaller."""
    return f"p = {change.p_value:.1g}" if change.p_value > LEAST_PROBABILITY else f"p < {LEAST_PROBABILITY:g}"


def _named(change: Change) -> int | None:
    """Return the identity of the wall in the map that a change names."""
    return change.new if change.old is None else change.old


def write_diff_geojson(path: Path, diff: MapDiff, corners: Sequence[CornerChange]) -> None:
    """Write a feature per change, in metres in the old map's frame, as in the GeoJSON export of maps."""
    features = [*map(_wall_feature, diff.changes), *map(_corner_feature, corners)]
    rows = ",\n".join(json.dumps(feature, allow_nan=False) for feature in features)
    motion = json.dumps([round(value, 6) for value in diff.motion.tolist()])
    head = f'"type": "FeatureCollection", "frame": "map", "units": "m", "new_map_at": {motion}'
    path.write_text(f'{{{head}, "features": [\n{rows}\n]}}\n', encoding="utf-8", newline="\n")


def _wall_feature(change: Change) -> dict[str, Any]:
    properties = {
        "kind": "wall",
        "change": change.kind.value,
        "old": change.old,
        "new": change.new,
        "p_value": _number(change.p_value),
        "shift": _number(change.shift),
        "turn": _number(change.turn),
        "sigma_shift": _number(change.sigma[0]),
        "sigma_turn": _number(change.sigma[1]),
        "seen_through_by": change.through,
        "seen_by": change.seen,
    }
    geometry = {"type": "MultiLineString", "coordinates": (np.round(change.stretches, 6) + 0.0).tolist()}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _corner_feature(corner: CornerChange) -> dict[str, Any]:
    shift = corner.shift.tolist() if np.isfinite(corner.shift).all() else None
    properties = {"kind": "corner", "change": corner.kind.value, "identity": corner.identity, "shift": shift}
    geometry = {"type": "Point", "coordinates": (np.round(corner.position, 6) + 0.0).tolist()}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _number(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


def write_diff_svg(path: Path, diff: MapDiff, old: WallGeometry, new: WallGeometry) -> None:
    """Draw both maps: grey walls are in both, orange ones only in the old map, blue ones only in the new one.

    Dotted walls are in one map only, but nothing shows that they are gone or new.
    """
    elements = [*_walls(diff, old, new), *_differences(diff, new)]
    points = np.concatenate([old.walls.end_points().reshape(-1, 2), _in_old(new, diff.motion).reshape(-1, 2)])
    low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    (width, height), left, top = high - low, low[0], -high[1]
    longer = float(max(width, height))
    scale = min(MILLIMETRES_PER_METRE, PAGE / longer)
    bar = draw_scale_bar(left, top + height, width, 1.0 / scale)
    height += bar.height
    size = f'width="{scale * width:.1f}mm" height="{scale * height:.1f}mm"'
    view = f'viewBox="{left:.3f} {top:.3f} {width:.3f} {height:.3f}"'
    stroke = max(STROKE * longer, LEAST_STROKE)
    sizes = (
        f"path {{ stroke-width: {stroke:.2f} }}\n"
        f".unseen {{ stroke-dasharray: 0 {DOT_SPACING * stroke:.2f} }}\n"
        f"text {{ font: {max(TEXT * longer, LEAST_TEXT):.2f}px sans-serif }}"
    )
    body = "\n".join([*elements, bar.elements])
    style = f"<style>{STYLE}{sizes}\n{SCALE_BAR_STYLE}</style>"
    text = f'<svg xmlns="http://www.w3.org/2000/svg" {size} {view}>\n{style}\n{body}\n</svg>\n'
    path.write_text(text, encoding="utf-8", newline="\n")


def _in_old(new: WallGeometry, motion: se2.Pose) -> Floats:
    """Return the end points (k, 2, 2) of the new walls' pieces in the old map's frame."""
    return np.asarray(se2.transform(motion, new.walls.piece_points()[0]))


def _walls(diff: MapDiff, old: WallGeometry, new: WallGeometry) -> Iterator[str]:
    """Yield the walls of the old map, and those of the new one that were not seen before."""
    classes = {change.old: "unseen" for change in diff.changes if change.kind is ChangeKind.NOT_SEEN_AGAIN}
    points, wall = old.walls.piece_points()
    for ends, row in zip(points, wall.tolist(), strict=True):
        identity = int(old.walls.identity[row])
        yield _path(classes.get(identity, "same"), ends, f"wall {identity}")
    before = {change.new for change in diff.changes if change.kind is ChangeKind.NOT_SEEN_BEFORE}
    for ends, row in zip(_in_old(new, diff.motion), new.walls.piece_points()[1].tolist(), strict=True):
        identity = int(new.walls.identity[row])
        if identity in before:
            yield _path("unseen", ends, f"new wall {identity}")


def _differences(diff: MapDiff, new: WallGeometry) -> Iterator[str]:
    """Yield the old places of walls in one colour and the new ones in the other; of moved walls the shift as text.

    Of a moved end, the stretch by which the wall is longer or shorter is drawn.
    """
    in_old, wall = _in_old(new, diff.motion), new.walls.piece_points()[1]
    for change in diff.changes:
        if change.kind not in DIFFERENCES:
            continue
        is_new = change.kind is ChangeKind.NEW or (change.kind is ChangeKind.END_MOVED and change.shift > 0.0)
        for ends in change.stretches:
            yield _path("new" if is_new else "old", ends, _line(change))
        if change.kind is ChangeKind.MOVED:
            for ends in in_old[new.walls.identity[wall] == change.new]:
                yield _path("new", ends, _line(change))
            x, y = change.stretches[0].mean(axis=0).tolist()
            yield f'<text x="{x + 0.1:.3f}" y="{-y - 0.1:.3f}">{1e3 * abs(change.shift):.0f} mm</text>'


def _path(name: str, ends: Floats, title: str) -> str:
    (x0, y0), (x1, y1) = ends.tolist()
    return f'<path class="{name}" d="M{x0:z.3f},{-y0:z.3f}L{x1:z.3f},{-y1:z.3f}"><title>{escape(title)}</title></path>'
