"""Plot a pose graph before and after optimisation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...geometry.segments import Floats
from ...graph.pose_graph import Edges, PoseGraph, odometry_edges
from .style import BLUE, INK, ORANGE, SKY, VERMILLION, legend, metric_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ...graph.pose_graph import OptimisedGraph


def plot_pose_graph(path: Path, before: PoseGraph, optimised: OptimisedGraph, *, title: str) -> None:
    """Plot the path before and after, loop edges, landmarks and outlier edges. Raises OutputError.

    The plot's extent is that of the optimised graph; the path before may leave it.
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
    inliers = optimised.inliers[: len(before.motions)]
    steps, loops = before.motions.select(odometry), before.motions.select(~odometry & inliers)
    _draw(axes, _between(steps, before.poses), color=ORANGE, linewidth=0.8, alpha=0.7, label="path before", zorder=2)
    outliers = before.select_edges(~optimised.inliers)
    to_landmarks = (_between(edges, after.poses, after.landmarks) for edges in outliers.edges_by_kind[1:])
    outlier_ends = [_between(outliers.motions, after.poses), *to_landmarks]
    _draw(
        axes, np.concatenate(outlier_ends), color=VERMILLION, linewidth=0.5, alpha=0.45, label="outlier edge", zorder=3
    )
    _draw(axes, _between(loops, after.poses), color=SKY, linewidth=0.8, label="loop edge", zorder=4)
    _draw(axes, _between(steps, after.poses), color=BLUE, linewidth=1.2, label="path", zorder=5)
    if len(after.landmarks):
        axes.plot(*after.landmarks.T, "+", color=INK, markersize=5, label="landmark", zorder=6)
    legend(axes)
    save(figure, path)


def _between(edges: Edges, poses: Floats, targets: Floats | None = None) -> Floats:
    """Return both ends (k, 2, 2) of each edge; the second is a pose unless other `targets` are given."""
    measured = poses if targets is None else targets
    return np.stack([poses[edges.source, :2], measured[edges.target, :2]], axis=1)


def _draw(axes: Axes, segments: Floats, **style: Any) -> None:
    from matplotlib.collections import LineCollection

    if len(segments):
        axes.add_collection(LineCollection(list(segments), **style), autolim=False)
