"""A pose graph before and after its optimisation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...graph.pose_graph import Edges, PoseGraph, odometry_edges
from .style import BLUE, INK, ORANGE, SKY, VERMILLION, Floats, legend, metric_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ...graph.pose_graph import OptimisedGraph


def plot_pose_graph(path: Path, before: PoseGraph, optimised: OptimisedGraph, *, title: str) -> None:
    """Draw the path before and after, loop edges, landmarks, and edges that were left out. Raises OutputError.

    The picture is as large as the optimised graph; what it was before may leave it.
    """
    after = optimised.graph
    drawn = np.concatenate([after.poses[:, :2], after.landmarks])
    landmarks = f"{len(after.landmarks)} landmarks, " if len(after.landmarks) else ""
    subtitle = (
        f"{len(after.poses)} poses, {landmarks}{before.edge_count} edges, "
        f"chi2 {optimised.chi2_before:.4g} before, {optimised.chi2:.4g} after"
    )
    figure, axes = metric_figure(np.array([drawn.min(axis=0), drawn.max(axis=0)]), title, subtitle)
    odometry = odometry_edges(before)[: len(before.motions)]
    kept = optimised.inliers[: len(before.motions)]
    steps, loops = before.motions.select(odometry), before.motions.select(~odometry & kept)
    _draw(axes, _between(steps, before.poses), color=ORANGE, linewidth=0.8, alpha=0.7, label="path before", zorder=2)
    out = before.select_edges(~optimised.inliers)
    to_landmarks = (_between(edges, after.poses, after.landmarks) for edges in out.edges_by_kind[1:])
    wrong = [_between(out.motions, after.poses), *to_landmarks]
    _draw(axes, np.concatenate(wrong), color=VERMILLION, linewidth=0.5, alpha=0.45, label="edge left out", zorder=3)
    _draw(axes, _between(loops, after.poses), color=SKY, linewidth=0.8, label="loop edge", zorder=4)
    _draw(axes, _between(steps, after.poses), color=BLUE, linewidth=1.2, label="path", zorder=5)
    if len(after.landmarks):
        axes.plot(*after.landmarks.T, "+", color=INK, markersize=5, label="landmark", zorder=6)
    legend(axes)
    save(figure, path)


def _between(edges: Edges, poses: Floats, targets: Floats | None = None) -> Floats:
    """(k, 2, 2): from where each edge is measured to what it measures, a pose where no other `targets` are given."""
    measured = poses if targets is None else targets
    return np.stack([poses[edges.source, :2], measured[edges.target, :2]], axis=1)


def _draw(axes: Axes, segments: Floats, **style: Any) -> None:
    from matplotlib.collections import LineCollection

    if len(segments):
        axes.add_collection(LineCollection(list(segments), **style), autolim=False)
