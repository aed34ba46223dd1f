"""Place the texts of rooms and dimension lines so that none covers another.

A text is a box: an array (5,) [x, y, direction, half length, half height], in metres and radians. A line is a box
without height.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...geometry.segments import Floats
from ...measuring.measured_map import MeasuredMap
from ...measuring.measurement import Kind
from ...measuring.rooms import Room
from .dimension_lines import (
    AREA_TEXT_HEIGHT,
    CHARACTER_WIDTH,
    TEXT_GAP,
    TEXT_HEIGHT,
    DimensionLine,
    dimension_lines,
    opening_text,
)

STEPS = 4
"""Number of places that are tried within the length of a text."""


def placed_dimensions(measured: MeasuredMap) -> list[tuple[DimensionLine, Floats]]:
    """Return the dimension lines of a map as `place_texts` does, beside the texts of rooms and openings."""
    areas = [text_box(place, text, 0.0, AREA_TEXT_HEIGHT) for place, text in placed_areas(measured)]
    return place_texts(
        dimension_lines(measured.measurements), np.array([*areas, *_opening_boxes(measured)]).reshape(-1, 5)
    )


def placed_areas(measured: MeasuredMap) -> list[tuple[Floats, str]]:
    """Return place (2,) and text of the area of each room.

    A text is inside its room if it fits there, covers no text of an opening, and crosses as few dimension lines as
    possible; of such places the nearest to the middle of the room is chosen. It is in the middle if the map has
    measurements of rooms only, but no rooms.
    """
    openings = np.array(_opening_boxes(measured)).reshape(-1, 5)
    strokes = np.array([_line_box(line) for line in dimension_lines(measured.measurements)]).reshape(-1, 5)
    placed = []
    for one in measured.measurements:
        if one.kind is Kind.AREA and one.room is not None:
            text = f"room {one.room}: {one.value:.2f} ± {max(one.sigma, 0.01):.2f} m²"
            box = text_box(one.ends[0], text, 0.0, AREA_TEXT_HEIGHT)
            if measured.rooms:
                box = _best_in_room(box, measured.rooms[one.room - 1], openings, strokes)
            placed.append((_below(box), text))
    return placed


def _best_in_room(box: Floats, room: Room, openings: Floats, strokes: Floats) -> Floats:
    """Return the box of the text of a room, which has the middle of the room, moved to the best place."""
    vertices, step = room.outline.vertices, 2.0 * AREA_TEXT_HEIGHT
    low, high = np.floor((vertices.min(axis=0) - box[:2]) / step), np.ceil((vertices.max(axis=0) - box[:2]) / step)
    shifts = step * np.stack(np.meshgrid(*map(np.arange, low, high)), axis=-1).reshape(-1, 2)
    shifts = shifts[np.argsort(np.hypot(*shifts.T), kind="stable")]
    share = np.linspace(-1.0, 1.0, 1 + math.ceil(2.0 * box[3] / step))
    edges = box[3:] * np.concatenate([[[x, y] for x in share] for y in (-1.0, 1.0)])
    outside = ~room.contains((box[:2] + shifts[:, None] + edges).reshape(-1, 2)).reshape(len(shifts), -1)
    costs = []
    for shift, parts in zip(shifts, outside, strict=True):
        moved = np.append(box[:2] + shift, box[2:])
        costs.append((int(parts.sum()), int(overlaps(moved, openings).sum()), int(overlaps(moved, strokes).sum())))
    best = min(range(len(shifts)), key=costs.__getitem__)  # the first one is nearest the middle
    return np.append(box[:2] + shifts[best], box[2:])


def _opening_boxes(measured: MeasuredMap) -> list[Floats]:
    return [text_box(*opening_text(opening)) for opening in measured.openings]


def place_texts(lines: Sequence[DimensionLine], others: Floats) -> list[tuple[DimensionLine, Floats]]:
    """Return the lines whose texts have room, each with the middle (2,) of the line's part below its text.

    others  (k, 5) boxes of texts whose places are given

    A text is in the middle of its line, or at the nearest place where it crosses fewer other lines. Texts of short
    lines are placed first, as those of long ones have more places to go to; a line is left out if its text would cover
    another one everywhere.
    """
    strokes = np.array([_line_box(line) for line in lines]).reshape(-1, 5)
    taken, found = np.asarray(others).reshape(-1, 5), {}
    for k in sorted(range(len(lines)), key=lambda k: strokes[k, 3]):
        crossed = np.delete(strokes, k, axis=0)
        boxes = [box for box in _places(lines[k]) if not overlaps(box, taken).any()]
        if boxes:
            best = min(boxes, key=lambda box: int(overlaps(box, crossed).sum()))  # the first one is nearest the middle
            taken = np.vstack([taken, best])
            found[k] = lines[k], _below(best)
    return [found[k] for k in sorted(found)]


def text_box(place: Floats, text: str, angle: float, height: float = TEXT_HEIGHT) -> Floats:
    """Return the box (5,) of a text whose lower edge is centred above a place (2,)."""
    half = 0.5 * CHARACTER_WIDTH * height * len(text), 0.5 * height
    x, y = place + (TEXT_GAP * height + half[1]) * np.array([-np.sin(angle), np.cos(angle)])
    return np.array([x, y, angle, *half])


def overlaps(box: Floats, others: Floats) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which of the boxes (k, 5) a box (5,) overlaps: no direction of their edges separates these from it."""
    apart = others[:, :2] - box[:2]
    turn = others[:, 2] - box[2]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    (length, height), (lengths, heights) = box[3:], others[:, 3:].T
    along, across = _in_directions(apart, np.full(len(others), box[2]))
    separate = (along > length + lengths * cos + heights * sin) | (across > height + lengths * sin + heights * cos)
    along, across = _in_directions(apart, others[:, 2])
    separate |= (along > lengths + length * cos + height * sin) | (across > heights + length * sin + height * cos)
    return np.asarray(~separate)


def _in_directions(vectors: Floats, angles: Floats) -> tuple[Floats, Floats]:
    """Return the distances (k,) of vectors (k, 2) along directions (k,) and across them."""
    x, y = vectors.T
    return np.abs(x * np.cos(angles) + y * np.sin(angles)), np.abs(y * np.cos(angles) - x * np.sin(angles))


def _line_box(line: DimensionLine) -> Floats:
    return np.array([*line.middle, line.angle, 0.5 * np.hypot(*(line.line[1] - line.line[0])), 0.0])


def _places(line: DimensionLine) -> list[Floats]:
    """Return the boxes of the line's text at all places, the one in the middle first, then by distance from it."""
    box = text_box(line.middle, line.text, line.angle)
    free = max(float(_line_box(line)[3] - box[3]), 0.0)
    steps = np.arange(1, int(free / (2.0 * box[3]) * STEPS) + 1) * (2.0 * box[3] / STEPS)
    along = np.array([np.cos(line.angle), np.sin(line.angle), 0.0, 0.0, 0.0])
    return [box + shift * along for shift in (0.0, *np.column_stack([steps, -steps]).ravel())]


def _below(box: Floats) -> Floats:
    """Return the place (2,) that `text_box` makes a box of."""
    x, y, angle, _, half = box
    distance = (1.0 + 2.0 * TEXT_GAP) * half
    return np.array([x + distance * np.sin(angle), y - distance * np.cos(angle)])
