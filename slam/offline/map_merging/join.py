"""Joining sessions: each found in the map of those before it, and made one with them; or refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...errors import MapError
from ...io.sessions import StoredSession
from ...loop_closure.relocalisation import index_map
from .agreement import Agreement, locate
from .union import united


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """The session that came of several, before refinement, and how those after the first were found, by name and in the
    order in which they were joined."""

    session: StoredSession
    found: Sequence[tuple[str, Agreement]]


def join(sessions: Sequence[tuple[str, StoredSession]]) -> Joined:
    """Make one of named sessions, in the map of the first. One that meets it only by way of another is found, too.

    The sessions are of no more use. Raises MapError naming the session that is not recognised, and why, or that brings
    nothing of its own.
    """
    _refuse_what_is_there_twice(sessions)
    for name, session in sessions:
        if not session.slam_state.mapper.keyframe_count:
            raise MapError(f"{name}: has no keyframe, so there is nothing to join")
        session.slam_state.mapper.settle()
    (_, whole), *left = sessions
    found: list[tuple[str, Agreement]] = []
    while left:
        agreements = _located(left, whole)
        best = max(range(len(left)), key=lambda k: (agreements[k].accepted, agreements[k].independent))
        name, session = left.pop(best)
        if not agreements[best].accepted:
            known = ", ".join([sessions[0][0], *(joined for joined, _ in found)])
            raise MapError(f"{name}: is not recognised in {known}: {agreements[best].reason}")
        try:
            whole = united(whole, session, agreements[best])
        except MapError as error:
            raise MapError(f"{name}: {error}") from error
        found.append((name, agreements[best]))
    return Joined(whole, found)


def _refuse_what_is_there_twice(sessions: Sequence[tuple[str, StoredSession]]) -> None:
    """What was seen once must not count as if it had been seen twice."""
    known: dict[tuple[object, ...], str] = {}
    for name, session in sessions:
        for recording in session.recordings:
            begin, end = (round(stamp - recording.shift, 3) for stamp in (recording.first, recording.last))
            content = recording.name, recording.path, begin, end
            if content in known:
                raise MapError(f"{name}: the recording {recording.name} in it is in {known[content]}, too")
            known[content] = name


def _located(sessions: Sequence[tuple[str, StoredSession]], whole: StoredSession) -> list[Agreement]:
    index = index_map(whole.slam_state.mapper)
    return [locate(session.slam_state.mapper, session.drive(), index) for _, session in sessions]
