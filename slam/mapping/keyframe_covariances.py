"""Covariances of keyframes' poses: those of the graph, with the correlated drift that it does not contain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2

from ..geometry.segments import Floats
from ..graph.covariances import ROBUST_COVARIANCE_SCALE
from ..graph.graph_estimate import Marginals
from ..odometry.correlated_drift import embed_position_covariance, rotate_covariance
from .drift_covariance import DriftCovariance

if TYPE_CHECKING:
    from .mapper import Mapper


class KeyframeCovariances:
    """Covariances (3, 3) of the keyframes' poses of a mapper, in metres and radians; it always shows the present map.

    The pose of a keyframe is that of its de-skewed scan: relative to the true pose of the base, the sweep covariance of
    its features counts as well.

    The stored covariance of a keyframe is that from when it was added, `Mapper.pose_covariances`.
    """

    def __init__(self, mapper: Mapper) -> None:
        self._mapper = mapper

    def of_last(self) -> Floats:
        """Return (3, 3) the covariance of the last keyframe's pose, in its own frame.

        As `of_keyframe`, but from the stored covariance, so it costs nothing.
        """
        return self._stored(self._mapper.keyframe_count - 1)

    def _stored(self, keyframe: int) -> Floats:
        mapper = self._mapper
        correlated = embed_position_covariance(mapper.correlated_drift[keyframe])
        independent = mapper.pose_covariances[keyframe] - correlated
        heading = mapper.keyframe_poses[keyframe, 2]
        return rotate_covariance(ROBUST_COVARIANCE_SCALE * independent + correlated, -heading)

    def of_keyframe(self, keyframe: int) -> Floats:
        """Return (3, 3) the covariance of a keyframe's pose, in its own frame (metres, metres, radians).

        That of a keyframe with which the graph is not solved yet is the stored one.
        """
        mapper = self._mapper
        if mapper.graph.is_waiting(keyframe):
            return self._stored(keyframe)
        correlated = embed_position_covariance(mapper.correlated_drift[keyframe])
        heading = mapper.graph.keyframe_pose(keyframe)[2]
        return mapper.graph.keyframe_covariance(keyframe) + rotate_covariance(correlated, -heading)

    def of_all(self, marginals: Marginals, drift: DriftCovariance) -> Floats:
        """Return (k, 3, 3) those of all keyframes, given the marginals of the graph and the drift."""
        mapper = self._mapper
        headings = mapper.graph.keyframe_poses(mapper.keyframe_count)[:, 2]
        c, s = np.cos(headings), np.sin(headings)
        to_keyframe = np.stack([c, s, -s, c], axis=-1).reshape(-1, 2, 2)
        covariances = marginals.keyframes(range(mapper.keyframe_count))
        values, vectors = np.linalg.eigh(drift.of(np.arange(mapper.keyframe_count)))
        axes = to_keyframe @ vectors
        covariances[:, :2, :2] += (axes * np.maximum(values, 0.0)[:, None]) @ axes.transpose(0, 2, 1)
        return covariances

    def relative(self, old: int, keyframe: int) -> Floats:
        """Return (3, 3) the covariance of a keyframe's pose relative to an older one, in its own frame."""
        mapper = self._mapper
        if mapper.gauge.separates(mapper, old, keyframe):
            return mapper.gauge.covariance_across(mapper, old, keyframe)
        return self.relative_in_graph(old, keyframe)

    def relative_to_all(self, old: Sequence[int], keyframe: int) -> list[Floats]:
        """Return (3, 3) the covariances of a keyframe's pose relative to each of some older ones; see `relative`."""
        mapper = self._mapper
        across = [mapper.gauge.separates(mapper, one, keyframe) for one in old]
        connected = [one for one, separate in zip(old, across, strict=True) if not separate]
        found = iter(mapper.graph.relative_covariances_to_all(connected, keyframe))
        return [
            mapper.gauge.covariance_across(mapper, one, keyframe)
            if separate
            else next(found) + self._relative_drift(one, keyframe)
            for one, separate in zip(old, across, strict=True)
        ]

    def relative_in_graph(self, old: int, keyframe: int) -> Floats:
        """Return the covariance as `relative` does, of keyframes that factors of the graph connect."""
        return self._mapper.graph.relative_covariance(old, keyframe) + self._relative_drift(old, keyframe)

    def _relative_drift(self, old: int, keyframe: int) -> Floats:
        """Return (3, 3) the correlated drift from an older keyframe to another one, in its own frame."""
        mapper = self._mapper
        correlated = embed_position_covariance(mapper.correlated_drift[keyframe] - mapper.correlated_drift[old])
        return rotate_covariance(correlated, -mapper.graph.keyframe_pose(keyframe)[2])

    def relative_bound(self, old: int, keyframe: int) -> Floats:
        """Return (3, 3) an upper bound of `relative` by the covariances from when the keyframes were added.

        The difference of two errors a and b has a covariance of at most 2 (Cov a + Cov b), whatever their correlation.
        Those of parts of the map that are not connected have different gauges: there it is exact.
        """
        mapper = self._mapper
        if mapper.gauge.separates(mapper, old, keyframe):
            return mapper.gauge.covariance_across(mapper, old, keyframe)
        poses = mapper.keyframe_poses
        heading = poses[keyframe, 2]
        of_old, of_keyframe = (rotate_covariance(mapper.pose_covariances[k], -heading) for k in (old, keyframe))
        lever = se2.between(poses[keyframe], poses[old])
        adjoint = se2.adjoint(np.array([lever[0], lever[1], 0.0]))  # both are in the axes of the keyframe
        return np.asarray(2.0 * (adjoint @ of_old @ adjoint.T + of_keyframe))
