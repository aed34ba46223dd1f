"""Joins of parts of a map, and what lies on both sides of one that a person forbids.

Of the closures between parts, those that connected parts for the first time are joins; the others rest on them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ...errors import MapError
from ...loop_closure.loop_status import LoopStatus
from ...mapping.map_parts import MapParts

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Separation:
    """Separation of the parts of a map that one join connects.

    part     first part of the later side; all parts of the other side are before it
    end      number after the last part of the later side
    resting  numbers of the other closures between the two sides, which rest on the join
    """

    part: int
    end: int
    resting: frozenset[int]


def separation_of(parts: MapParts, decisions: Sequence[Row], loop: int) -> Separation | None:
    """Return what is separated if a loop is forbidden; None if the loop is no join.

    decisions  loop decisions, as in summary.json, in their order

    Raises MapError if the later side does not follow on the other one, or if parts are connected by merging sessions.
    """
    accepted = [row for row in decisions if row["status"] == LoopStatus.ACCEPTED]
    ends = {row["candidate"]: (parts.part(row["old"]), parts.part(row["keyframe"])) for row in accepted}
    joins = _joins(ends, len(parts))
    if loop not in joins:
        return None
    of_part = _roots([ends[number] for number in joins], len(parts))
    if not len(set(zip(of_part, parts.groups, strict=True))) == len(set(of_part)) == len(set(parts.groups)):
        raise MapError(f"loop {loop} cannot be forbidden in a merged session: correct the sessions, then merge them")
    sides = _roots([ends[number] for number in joins if number != loop], len(parts))
    old, recent = (sides[end] for end in ends[loop])
    one, other = ([k for k, side in enumerate(sides) if side == which] for which in (old, recent))
    earlier, later = sorted((one, other))
    if earlier[-1] > later[0]:
        between = next(
            n for n in joins if n != loop and max(ends[n]) > later[0] and sides[ends[n][0]] == sides[earlier[0]]
        )
        raise MapError(
            f"loop {loop} cannot be forbidden before loop {between}, which joins a later part of the map: forbid that "
            f"one first, then this one, and close {between} again"
        )
    across = {number for number, (a, b) in ends.items() if {sides[a], sides[b]} == {old, recent}}
    return Separation(later[0], later[-1] + 1, frozenset(across - {loop}))


def _joins(ends: Mapping[int, tuple[int, int]], count: int) -> list[int]:
    """Return the numbers of the closures that connected parts not connected by the closures before them."""
    joins: list[int] = []
    for number, (first, second) in ends.items():
        roots = _roots([ends[other] for other in joins], count)
        if roots[first] != roots[second]:
            joins.append(number)
    return joins


def _roots(pairs: Sequence[tuple[int, int]], count: int) -> list[int]:
    """Return for each of some parts the oldest one that pairs connect it with."""
    roots = list(range(count))
    for first, second in pairs:
        low, high = sorted((roots[first], roots[second]))
        roots = [low if root == high else root for root in roots]
    return roots
