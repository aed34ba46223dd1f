"""Convergence of a finished map: duplicate walls merged, different ones split, the estimate iterated to its optimum."""

from __future__ import annotations

from ..graph.final_solution import solve_with_range_bias
from .mapper import Mapper
from .read_back import recompute_covariances
from .wall_merging import merge_duplicate_walls
from .wall_splitting import find_splits, split_landmark, with_new_walls


def converge(mapper: Mapper) -> int:
    """Merge duplicate walls of the whole map, split those that are two, iterate to convergence, and read all back.

    A part of the map that is not connected is held by odometry from then on.

    Return the number of walls merged.
    """
    mapper.solve_waiting()
    mapper.gauge.release(mapper)
    mapper.graph.update_until_converged()
    settle_range_bias(mapper)  # before merging: iSAM2 leaves out small steps, and walls are merged where they are
    merged = merge_duplicate_walls(mapper.landmarks, mapper.graph, mapper.roughness.variances, mapper.merge_walls)
    if merged:
        mapper.graph.update_until_converged()
        mapper.read_back()
    split_walls(mapper)
    settle_range_bias(mapper, correlate=True)
    mapper.read_back_all()
    return merged


def settle_range_bias(mapper: Mapper, *, correlate: bool = False) -> None:
    """Estimate the range bias together with the graph, which has converged, and read all back.

    For `correlate` see `solve_with_range_bias`.
    """
    solve_with_range_bias(mapper.graph, correlate=correlate)
    mapper.read_back()


def split_walls(mapper: Mapper) -> int:
    """Split walls whose stretches are different surfaces, and return the number of new walls.

    The estimate has converged and is read back, before and afterwards.
    """
    landmarks, graph = mapper.landmarks, mapper.graph
    splits = find_splits(landmarks, graph, mapper.keyframe_poses, mapper.roughness.variances)
    moves = [(split_landmark(landmarks, split), split.frame, split.segments) for split in splits]
    if not moves:
        return 0
    graph.move_wall_segments(moves)
    graph.update_until_converged()
    mapper.landmark_ids = with_new_walls(mapper.landmark_ids, moves)
    recompute_covariances(landmarks, graph, [wall for wall, _, _ in moves])
    mapper.free_space_evidence.discard([split.wall for split in splits])
    mapper.read_back()
    return len(moves)
