"""Merge several sessions: locate each in the map of those before it and merge it with them, or refuse it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from drivers.immutable import immutable
from features.normal_limits import GROSS_LIMIT

from ...errors import MapError
from ...graph.range_bias import PRIOR_SIGMA, RangeBias
from ...io.sessions import StoredSession
from ...mapping.convergence import converge
from ...mapping.manual_changes import fragile_changes
from ...recognition.location import OVERLAP, Location, locate
from .pairwise_merge import merge_pair
from .session_scans import drive_of, map_of


@immutable
class MergedSession:
    """Session merged from several, before refinement.

    session   in the map frame of the first
    added     name and location of the other sessions, in the order in which they were merged
    warnings  texts on sessions that contradict each other
    """

    session: StoredSession
    added: Sequence[tuple[str, Location]]
    warnings: Sequence[str]


def merge_sessions(sessions: Sequence[tuple[str, StoredSession]]) -> MergedSession:
    """Merge named sessions into the map of the first; the order of the others does not matter.

    A session that overlaps the first only by way of another is merged after that one. The sessions are changed and
    cannot be used afterwards. Raises MapError naming the session that has no keyframe, has manual corrections that
    would be lost, is not recognised, or contains a recording that another contains too.
    """
    _check_recordings(sessions)
    for name, session in sessions:
        if not session.slam_state.mapper.keyframe_count:
            raise MapError(f"{name}: has no keyframe, so it cannot be merged")
        if changes := fragile_changes(session.slam_state.mapper):
            raise MapError(f"{name}: has {changes}, which merging would drop; merge before correcting")
        converge(session.slam_state.mapper)
    warnings = different_ranges([(name, session.slam_state.mapper.graph.range_bias) for name, session in sessions])
    (_, merged), *remaining = sessions
    added: list[tuple[str, Location]] = []
    scanned = {name: drive_of(session) for name, session in remaining}
    while remaining:
        old = map_of(merged)
        locations = [locate(scanned[name], old, OVERLAP) for name, _ in remaining]
        best = max(range(len(remaining)), key=lambda k: (locations[k].accepted, locations[k].evidence))
        (name, session), location = remaining.pop(best), locations[best]
        if not location.accepted:
            merged_names = ", ".join([sessions[0][0], *(added_name for added_name, _ in added)])
            raise MapError(f"{name}: is not recognised in {merged_names}: {location.reason}")
        try:
            merged = merge_pair(merged, session, location.members)
        except MapError as error:
            raise MapError(f"{name}: {error}") from error
        added.append((name, location))
    return MergedSession(merged, added, warnings)


def different_ranges(biases: Sequence[tuple[str, RangeBias]]) -> list[str]:
    """Return a text on each session whose range bias is clearly not that of the first, as the map has one only."""
    (first, expected), *others = biases
    texts = []
    for name, bias in others:
        difference, sigma = bias.metres - expected.metres, math.hypot(bias.sigma, expected.sigma)
        if abs(difference) > max(GROSS_LIMIT * sigma, PRIOR_SIGMA):
            compared = f"{abs(difference):.3f} ± {sigma:.3f} m {'longer' if difference > 0.0 else 'shorter'}"
            texts.append(
                f"{name}: its ranges are {compared} than those of {first}, so widths in the merged map are those of "
                "neither: map it again with lidar.range_bias"
            )
    return texts


def _check_recordings(sessions: Sequence[tuple[str, StoredSession]]) -> None:
    """Raise MapError if two sessions contain the same recording: its observations would count twice."""
    names: dict[tuple[object, ...], str] = {}
    for name, session in sessions:
        for recording in session.recordings:
            first, last = (round(stamp - recording.shift, 3) for stamp in (recording.first, recording.last))
            key = recording.name, recording.path, first, last
            if key in names:
                hint = "" if recording.path else "; if these are two drives, save their runs under two names"
                raise MapError(f"{name}: contains the recording {recording.name}, and so does {names[key]}{hint}")
            names[key] = name
