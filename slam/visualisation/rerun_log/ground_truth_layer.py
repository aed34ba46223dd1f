"""Draw ground truth: the true path, and the errors of keyframes over time."""

from __future__ import annotations

import math

from drivers import se2

from .ground_truth_errors import GroundTruthErrors
from .path_layer import PathLayer
from .rrd_writer import RrdWriter
from .time_series import TimeSeries


class GroundTruthLayer:
    """True poses in the map frame, from the first keyframe with a true pose, which aligns the frames."""

    def __init__(self, writer: RrdWriter, path_layer: PathLayer, time_series: TimeSeries) -> None:
        self._writer, self._path_layer, self._time_series = writer, path_layer, time_series
        self._errors = GroundTruthErrors()
        self._unaligned: list[se2.Pose] = []  # true poses received before the alignment was known

    @property
    def aligned(self) -> bool:
        """True if the log has ground truth in the map frame."""
        return self._errors.alignment is not None

    def add_keyframe(self, index: int, stamp: float, pose: se2.Pose) -> None:
        """Add an estimated pose in the map frame, and log the errors that have become computable."""
        self._errors.add_keyframe(index, stamp, pose)
        self._log_errors()

    def add_true_pose(self, stamp: float, pose: se2.Pose) -> None:
        """Add a true pose in the world frame: log errors that have become computable, extend the true path."""
        self._errors.add_true_pose(stamp, pose)
        self._unaligned.append(pose)
        self._log_errors()
        if self.aligned:
            for waiting in self._unaligned:
                self._path_layer.add_true_pose(self._errors.to_map(waiting))
            self._unaligned.clear()

    def _log_errors(self) -> None:
        for error in self._errors.new_errors():
            self._writer.set_time(error.stamp, error.index)
            values = {"position [cm]": 100 * error.position, "heading [°]": math.degrees(error.heading)}
            self._time_series.log("error", values)
