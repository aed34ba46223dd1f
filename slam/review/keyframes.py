"""What one keyframe looks like: the robot, its scan, what was extracted from it and what that was matched with."""

from __future__ import annotations

import math

import numpy as np
import rerun as rr

from drivers import se2

from ..events import Integers, KeyframeAdded, MapCorners, MapLines
from ..segments import Floats
from . import colours, documents
from .colours import Colour
from .metrics import Metrics
from .shapes import ROUND_SCAN, Layer, ellipses, lift, segment_ends, wall_links

# An arrow that points ahead, metres.
ROBOT_OUTLINE = np.array([[0.3, 0.0], [-0.2, 0.2], [-0.1, 0.0], [-0.2, -0.2], [0.3, 0.0]])

_SCAN_SIZE, _CORNER_SIZE = rr.Radius.ui_points(1.4), rr.Radius.ui_points(3.5)
_THIN, _THICK = rr.Radius.ui_points(0.7), rr.Radius.ui_points(2.2)


class KeyframeLayer:
    """Logs keyframes at the stream's current time."""

    def __init__(self, stream: rr.RecordingStream, metrics: Metrics) -> None:
        self._stream = stream
        self._metrics = metrics
        outline = lift(ROBOT_OUTLINE, Layer.ESTIMATE)
        stream.log(
            "world/robot/outline", rr.LineStrips3D([outline], colors=colours.ESTIMATE, radii=_THICK), static=True
        )
        dot = rr.Points3D(lift([[0.0, 0.0]], Layer.ESTIMATE), colors=colours.ESTIMATE, radii=_CORNER_SIZE)
        stream.log("world/robot/position", dot, static=True)  # seen on a map too large for the outline

    def place_robot(self, pose: se2.Pose) -> None:
        """Move the robot, not the scan of its last keyframe."""
        self._stream.log("world/robot", _placed(pose))

    def log(self, event: KeyframeAdded, explained: float, lines: MapLines | None, corners: MapCorners | None) -> None:
        """Log a keyframe.

        `explained` is what its scan's registration said; `lines` and `corners` are the map as last heard of.
        """
        position_sigma, heading_sigma = self._log_pose(event)
        self._log_features(event, lines, corners)
        self._log_metrics(event, explained, position_sigma, heading_sigma)
        report = documents.keyframe(event, position_sigma, heading_sigma)
        self._stream.log("keyframe", rr.TextDocument(report, media_type=rr.MediaType.MARKDOWN))

    def _log_pose(self, event: KeyframeAdded) -> tuple[float, float]:
        """Robot, pose ellipse and scan.

        Returns the largest sigma of the position (metres) and the sigma of the heading (radians); NaN where unknown.
        """
        self.place_robot(event.pose)
        covariance = event.pose_covariance
        centres, half_sizes, quaternions = ellipses(np.zeros((1, 2)), covariance[None, :2, :2], Layer.SIGMA)
        ellipse = rr.Ellipsoids3D(
            centers=centres,
            half_sizes=half_sizes,
            quaternions=quaternions,
            colors=colours.POSE_SIGMA,
            fill_mode=rr.components.FillMode.Solid,
        )
        points = rr.Points3D(lift(event.points, Layer.SCAN, ROUND_SCAN), colors=colours.SCAN, radii=_SCAN_SIZE)
        self._stream.log("world/keyframe", _placed(event.pose))
        self._stream.log("world/keyframe/sigma", ellipse)
        self._stream.log("world/keyframe/scan", points)
        if not np.isfinite(covariance).all():
            return math.nan, math.nan
        variance = float(np.linalg.eigvalsh(covariance[:2, :2])[-1])
        return math.sqrt(max(variance, 0.0)), math.sqrt(max(float(covariance[2, 2]), 0.0))

    def _log_features(self, event: KeyframeAdded, lines: MapLines | None, corners: MapCorners | None) -> None:
        new = set(event.new_lines.tolist())
        ends = segment_ends(event.segments, event.pose)
        labels = [documents.match_label("L", event.line_match, event.line_gate, i, new) for i in range(len(ends))]
        segments = rr.LineStrips3D(
            lift(ends, Layer.FEATURE),
            colors=_match_colours(event.line_match, new),
            labels=labels,
            show_labels=False,
            radii=_THICK,
        )
        position = se2.transform(event.pose, event.corners.position.reshape(-1, 2))
        labels = [
            documents.match_label("C", event.corner_match, event.corner_gate, i, set()) for i in range(len(position))
        ]
        points = rr.Points3D(
            lift(position, Layer.FEATURE),
            colors=_match_colours(event.corner_match, set()),
            labels=labels,
            show_labels=False,
            radii=_CORNER_SIZE,
        )
        links = _links(ends.mean(axis=1), event.line_match, lines, position, event.corner_match, corners)
        strips = rr.LineStrips3D(lift(links, Layer.LINK), colors=colours.MATCHED, radii=_THIN)
        self._stream.log("world/features/segments", segments)
        self._stream.log("world/features/corners", points)
        self._stream.log("world/features/links", strips)
        self._stream.log("association/lines", rr.AnyValues(match=event.line_match, gate=event.line_gate))
        self._stream.log("association/corners", rr.AnyValues(match=event.corner_match, gate=event.corner_gate))

    def _log_metrics(self, event: KeyframeAdded, explained: float, position_sigma: float, heading_sigma: float) -> None:
        new = np.isin(event.line_match, event.new_lines)
        gates = event.line_gate[(event.line_match >= 0) & ~new & np.isfinite(event.line_gate)]
        sigma = {
            "position [cm]": 100 * position_sigma,
            "heading [°]": math.degrees(heading_sigma),
            "range [cm]": 100 * event.sigma_range,
        }
        self._metrics.log("explained", {"share of wall length": explained})
        self._metrics.log("sigma", sigma)
        self._metrics.log("association", {"largest d²": float(gates.max()) if len(gates) else math.nan})
        self._metrics.log("time", event.timings)
        self._metrics.log("counts", event.counts)


def _placed(pose: se2.Pose) -> rr.Transform3D:
    x, y, heading = (float(value) for value in pose)
    turn = rr.Quaternion(xyzw=[0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)])
    return rr.Transform3D(translation=[x, y, 0.0], quaternion=turn)


def _match_colours(match: Integers, new: set[int]) -> list[Colour]:
    return [
        colours.UNMATCHED if identity < 0 else colours.NEW if identity in new else colours.MATCHED
        for identity in match.tolist()
    ]


def _links(
    centres: Floats,
    line_match: Integers,
    lines: MapLines | None,
    position: Floats,
    corner_match: Integers,
    corners: MapCorners | None,
) -> Floats:
    """(k, 2, 2): from each matched feature to what it was matched with, as far as the map is known."""
    found = [np.empty((0, 2, 2))]
    if lines is not None:
        found.append(wall_links(centres, line_match, lines))
    if corners is not None:
        row = {int(identity): i for i, identity in enumerate(corners.identity)}
        pairs = [(position[i], corners.position[row[k]]) for i, k in enumerate(corner_match.tolist()) if k in row]
        found.append(np.array(pairs).reshape(-1, 2, 2))
    return np.concatenate(found)
