"""Apply manual corrections to a session, solve its graph again, and match all scans to the corrected map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers import se2
from drivers.immutable import immutable

from ...errors import MapError
from ...estimation.refinement import match_trajectory
from ...events import Finished
from ...io.sessions import StoredSession
from ...io.sessions.corrections import (
    Correction,
    LoopForbidding,
    PinSet,
    PlaceClosing,
    ProposedClosing,
    WallDeletion,
    WallTie,
)
from ...io.tum import Trajectory
from ...io.wall_maps import settled_wall_map
from ...localisation.tracking import PoseFix
from ...mapping.convergence import converge
from ...mapping.manual_changes import delete_wall, tie_walls
from ...measuring.measurement import are_parallel
from ...measuring.wall_map import WallMap
from ...reporting.publisher import Publisher
from ..optimisation import summarise_session
from .loops import LoopCorrector
from .pin_places import PinPlaces
from .pins import apply_pins


@immutable
class CorrectedSession:
    """Result of correcting a session.

    finished  the final map and trajectory
    session   the session to continue from
    outcomes  of each correction, with its `text`, for summary.json
    loops     loop decisions by the corrections, as in summary.json
    """

    finished: Finished
    session: StoredSession
    outcomes: list[dict[str, Any]]
    loops: list[dict[str, Any]]


def correct_session(session: StoredSession, path: Trajectory, corrections: Sequence[Correction]) -> CorrectedSession:
    """Apply corrections in their order to an uncorrected session, which must not be used afterwards.

    path  the path in the results of that session, by whose stamps poses are pinned

    Identities of walls are those of its map. Raises MapError if a correction names a wall or a loop that the session
    does not have, or if the graph cannot be solved with it.
    """
    state, mapper = session.slam_state, session.slam_state.mapper
    if not mapper.keyframe_count:
        raise MapError("nothing to correct: the session has no keyframe")
    converge(mapper)
    places, loops = PinPlaces(session, path), LoopCorrector(session)
    outcomes = []
    for k, correction in enumerate(corrections):
        ties = [one.walls for one in corrections[:k] if isinstance(one, WallTie)]
        outcomes.append({"text": correction.text} | _apply(session, places, loops, correction, ties))
    converge(mapper)
    history = loops.history
    state.trajectory = match_trajectory(
        mapper, history, state.odometry_model, state.local_field.path_distances(mapper.travelled)
    )
    mapper.recompute_pose_covariances()
    last = session.scan_history().scan_poses(mapper.keyframe_poses)[-1]
    fix = PoseFix(last, session.scans[-1].reading)
    state.replace_map(mapper, state.trajectory, fix, history.keyframe_scans)
    return CorrectedSession(summarise_session(session, {}, Publisher(())), session, outcomes, loops.decided)


def _apply(
    session: StoredSession,
    places: PinPlaces,
    loops: LoopCorrector,
    correction: Correction,
    ties: Sequence[tuple[int, int]],
) -> dict[str, Any]:
    """Apply one correction to a map that has converged; return its outcome. `ties` are those applied before."""
    mapper, wall_map = session.slam_state.mapper, settled_wall_map(session.slam_state.mapper)
    match correction:
        case PinSet():
            try:
                return apply_pins(mapper, places, correction, wall_map)
            except MapError as error:
                raise MapError(f"{correction.file}: {error}") from error
        case WallDeletion():
            wall_map.row(correction.wall)
            delete_wall(mapper, correction.wall)
            return {}
        case ProposedClosing() | PlaceClosing():
            return loops.close(correction, ties)
        case LoopForbidding():
            return loops.forbid(correction, ties)
        case WallTie():
            outcome = _tied(wall_map, *correction.walls)
            tie_walls(mapper, *correction.walls)
            return outcome


def _tied(wall_map: WallMap, kept: int, absorbed: int) -> dict[str, Any]:
    """Return how far two walls are apart: metres, radians, and standard deviations.

    The distance is that of the nearer end of one from the line of the other. Raises MapError if the walls cannot be
    one.
    """
    first, second = wall_map.row(kept), wall_map.row(absorbed)
    if first == second:
        raise MapError(f"wall {kept} cannot be tied to itself")
    frames, ends = wall_map.walls.frame, wall_map.walls.end_points()[second]
    turn = float(se2.wrap(frames[second, 2] - frames[first, 2]))
    if not are_parallel(wall_map, first, second) or abs(turn) > 0.5 * np.pi:
        raise MapError(f"walls {kept} and {absorbed} cannot be one: they are not parallel or face opposite sides")
    alongs = [wall_map.along(first, end) for end in ends]
    middle = 0.5 * (float(wall_map.walls.low[first]) + float(wall_map.walls.high[first]))
    end = ends[int(np.argmin([abs(along - middle) for along in alongs]))]
    offset = float(wall_map.normal(first) @ (end - frames[first, :2]))
    gradients = np.stack(
        [
            wall_map.shift(second, wall_map.along(second, end)) - wall_map.shift(first, wall_map.along(first, end)),
            wall_map.turn(second) - wall_map.turn(first),
        ]
    )
    difference = np.array([offset, turn])
    squared = float(difference @ np.linalg.solve(gradients @ wall_map.covariance @ gradients.T, difference))
    return {"offset": offset, "turn": turn, "deviations": float(np.sqrt(squared))}
