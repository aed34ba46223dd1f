"""What one keyframe looks like: the robot, its scan, what was extracted from it and what that was matched with."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import rerun as rr

from drivers import se2

from ...events import KeyframeAdded, MapCorners, MapWalls
from . import colours, documents
from .colours import Colour
from .matches import Matches
from .metrics import Metrics
from .recording import Recording
from .shapes import ROUND_SCAN, Drawn, Layer, corner_links, ellipses, lift, segment_ends, wall_links

# An arrow that points ahead, metres.
ROBOT_OUTLINE = np.array([[0.3, 0.0], [-0.2, 0.2], [-0.1, 0.0], [-0.2, -0.2], [0.3, 0.0]])

_SCAN_SIZE, _CORNER_SIZE = rr.Radius.ui_points(0.9), rr.Radius.ui_points(3.5)
_THIN, _THICK = rr.Radius.ui_points(0.7), rr.Radius.ui_points(2.5)


class KeyframeLayer:
    """Logs keyframes at the recording's present time."""

    def __init__(self, recording: Recording, metrics: Metrics) -> None:
        self._recording = recording
        self._metrics = metrics
        self._filled: set[str] = set()  # entities whose last row was not empty
        outline = lift(ROBOT_OUTLINE, Layer.ESTIMATE)
        recording.keep("world/robot/outline", rr.LineStrips3D([outline], colors=colours.ESTIMATE, radii=_THICK))
        dot = rr.Points3D(lift([[0.0, 0.0]], Layer.ESTIMATE), colors=colours.ESTIMATE, radii=_CORNER_SIZE)
        recording.keep("world/robot/position", dot)  # seen on a map too large for the outline
        scan = rr.Points3D.from_fields(colors=colours.SCAN, radii=_SCAN_SIZE)
        recording.keep("world/keyframe/scan", scan)
        ellipse = rr.components.FillMode.MajorWireframe  # what is filled hides what matters
        spread = rr.Ellipsoids3D.from_fields(colors=colours.ESTIMATE, line_radii=_THIN, fill_mode=ellipse)
        recording.keep("world/keyframe/sigma", spread)
        segments = rr.LineStrips3D.from_fields(radii=_THICK, show_labels=False)
        recording.keep("world/features/segments", segments)
        recording.keep("world/features/corners", rr.Points3D.from_fields(radii=_CORNER_SIZE, show_labels=False))
        for name, colour in (("matched", colours.MATCHED), ("gated_out", colours.REFUSED)):
            recording.keep(f"world/features/{name}", rr.LineStrips3D.from_fields(radii=_THIN, colors=colour))

    def move_robot(self, pose: se2.Pose) -> None:
        """Move the robot between keyframes, not the scan of the last one."""
        self._recording.gather("world/robot", pose, _ways)

    def place(self, pose: se2.Pose) -> None:
        """Move the robot and its last scan, with the map."""
        x, y = (float(value) for value in pose[:2])
        self._recording.log("world/robot", _placed(pose))
        self._recording.log("world/here", rr.Transform3D(translation=[x, y, 0.0]))
        self._recording.log("world/keyframe", _placed(pose))

    def log(
        self, event: KeyframeAdded, overlap_ratio: float, lines: MapWalls | None, corners: MapCorners | None
    ) -> float:
        """Log a keyframe; returns the largest sigma of its position, metres, NaN where unknown.

        `explained` is what its scan's registration said; `lines` and `corners` are the map as last heard of.
        """
        position_sigma, heading_sigma = self._log_pose(event)
        self._log_features(event, lines, corners)
        self._log_metrics(event, overlap_ratio, position_sigma, heading_sigma)
        report = documents.keyframe(event, position_sigma, heading_sigma)
        self._recording.log("keyframe", rr.TextDocument(report, media_type=rr.MediaType.MARKDOWN))
        return position_sigma

    def _log_pose(self, event: KeyframeAdded) -> tuple[float, float]:
        """Robot, pose ellipse and scan.

        Returns the largest sigma of the position (metres) and the sigma of the heading (radians); NaN where unknown.
        """
        self.place(event.pose)
        covariance = event.pose_covariance
        centres, half_sizes, quaternions = ellipses(np.zeros((1, 2)), covariance[None, :2, :2], Layer.SIGMA)
        ellipse = rr.Ellipsoids3D.from_fields(centers=centres, half_sizes=half_sizes, quaternions=quaternions)
        points = rr.Points3D.from_fields(positions=lift(event.points, Layer.SCAN, ROUND_SCAN))
        self._recording.log("world/keyframe/sigma", ellipse)
        self._recording.log("world/keyframe/scan", points)
        if not np.isfinite(covariance).all():
            return math.nan, math.nan
        variance = float(np.linalg.eigvalsh(covariance[:2, :2])[-1])
        return math.sqrt(max(variance, 0.0)), math.sqrt(max(float(covariance[2, 2]), 0.0))

    def _log_features(self, event: KeyframeAdded, lines: MapWalls | None, corners: MapCorners | None) -> None:
        ends = segment_ends(event.segments, event.pose)
        position = se2.transform(event.pose, event.corners.position.reshape(-1, 2))
        walls, points = Matches.of_lines(event), Matches.of_corners(event)
        segments = rr.LineStrips3D.from_fields(
            strips=lift(ends, Layer.FEATURE), colors=_match_colours(walls), labels=walls.labels()
        )
        dots = rr.Points3D.from_fields(
            positions=lift(position, Layer.FEATURE), colors=_match_colours(points), labels=points.labels()
        )
        self._recording.log("world/features/segments", segments)
        self._recording.log("world/features/corners", dots)
        for name, of_walls, of_points in (
            ("matched", walls.matched, points.matched),
            ("gated_out", walls.gated_out, points.gated_out),
        ):
            found = [np.empty((0, 2, 2))]
            if lines is not None:
                found.append(wall_links(ends.mean(axis=1), of_walls, lines))
            if corners is not None:
                found.append(corner_links(position, of_points, corners))
            links = lift(np.concatenate(found), Layer.LINK)
            self._log_unless_empty_again(f"world/features/{name}", links)

    def _log_unless_empty_again(self, entity: str, strips: Drawn) -> None:
        if len(strips) or entity in self._filled:
            self._recording.log(entity, rr.LineStrips3D.from_fields(strips=strips))
        (self._filled.add if len(strips) else self._filled.discard)(entity)

    def _log_metrics(
        self, event: KeyframeAdded, overlap_ratio: float, position_sigma: float, heading_sigma: float
    ) -> None:
        gates = event.line_gate[(event.line_match >= 0) & np.isfinite(event.line_gate)]
        sigma = {
            "position [cm]": 100 * position_sigma,
            "heading [°]": math.degrees(heading_sigma),
            "range [cm]": 100 * event.sigma_range,
        }
        self._metrics.log("overlap_ratio", {"share of wall length": overlap_ratio})
        self._metrics.log("sigma", sigma)
        self._metrics.log("association", {"largest d²": float(gates.max()) if len(gates) else math.nan})
        self._metrics.log("time", {"total": sum(event.timings.values())} | event.timings)
        self._metrics.log("counts", event.counts)


def _placed(pose: se2.Pose) -> rr.Transform3D:
    x, y, heading = (float(value) for value in pose)
    turn = rr.Quaternion(xyzw=[0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)])
    return rr.Transform3D(translation=[x, y, 0.0], quaternion=turn)


def _ways(poses: list[se2.Pose]) -> Iterable[Any]:
    x, y, heading = np.array(poses).T
    none = np.zeros(len(x))
    turns = np.stack([none, none, np.sin(heading / 2), np.cos(heading / 2)], axis=-1)
    return rr.Transform3D.columns(translation=np.stack([x, y, none], axis=-1), quaternion=turns)


def _match_colours(matches: Matches) -> list[Colour]:
    return [
        colours.REFUSED if identity < 0 else colours.NEW if new else colours.MATCHED
        for identity, new in zip(matches.identity.tolist(), matches.new.tolist(), strict=True)
    ]
