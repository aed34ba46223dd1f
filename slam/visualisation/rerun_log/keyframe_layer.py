"""Draw one keyframe: the robot, its scan, the extracted features and their associations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import rerun as rr

from drivers import se2

from ...events import KeyframeAdded, Relocalised
from ...geometry.segments import Floats
from ...mapping.map_features import MapCorners, MapWalls
from . import colours, documents
from .colours import Colour
from .feature_matches import FeatureMatches
from .map_layer import FILLED
from .rrd_writer import MAX_BATCH_AGE, RrdWriter
from .shapes import SCAN_STEPS, Float32s, Height, corner_links, ellipses, segment_ends, to_3d, wall_links
from .time_series import TimeSeries

# An arrow that points ahead, metres.
ROBOT_OUTLINE = np.array([[0.3, 0.0], [-0.2, 0.2], [-0.1, 0.0], [-0.2, -0.2], [0.3, 0.0]])

_SCAN_SIZE, _CORNER_SIZE = rr.Radius.ui_points(0.9), rr.Radius.ui_points(3.5)
_THIN, _THICK = rr.Radius.ui_points(0.7), rr.Radius.ui_points(2.5)


class KeyframeLayer:
    """The robot and the last keyframe, logged at the writer's current time."""

    def __init__(self, writer: RrdWriter, time_series: TimeSeries) -> None:
        self._writer, self._time_series = writer, time_series
        self._non_empty: set[str] = set()  # entities whose last row was not empty
        self._relocalisations: list[se2.Pose] = []
        self._event: KeyframeAdded | None = None  # the last one
        outline = to_3d(ROBOT_OUTLINE, Height.ESTIMATE)
        writer.log_static("world/robot/outline", rr.LineStrips3D([outline], colors=colours.ESTIMATE, radii=_THICK))
        dot = rr.Points3D(to_3d([[0.0, 0.0]], Height.ESTIMATE), colors=colours.ESTIMATE, radii=_CORNER_SIZE)
        writer.log_static("world/robot/position", dot)  # visible on a map too large for the outline
        scan = rr.Points3D.from_fields(colors=colours.SCAN, radii=_SCAN_SIZE)
        writer.log_static("world/keyframe/scan", scan)
        spread = rr.Ellipsoids3D.from_fields(colors=colours.ESTIMATE, line_radii=_THIN, fill_mode=FILLED)
        writer.log_static("world/keyframe/sigma", spread)
        segments = rr.LineStrips3D.from_fields(radii=_THICK, show_labels=False)
        writer.log_static("world/features/segments", segments)
        writer.log_static("world/features/corners", rr.Points3D.from_fields(radii=_CORNER_SIZE, show_labels=False))
        for name, colour in (("matched", colours.MATCHED), ("gated_out", colours.ODOMETRY)):
            writer.log_static(f"world/features/{name}", rr.LineStrips3D.from_fields(radii=_THIN, colors=colour))
        # Shown at the cursor only: the label of the loop that joins the parts of the map is at the same place.
        relocalised = rr.LineStrips3D.from_fields(radii=_THIN, colors=colours.MATCHED, show_labels=False)
        writer.log_static("world/relocalisations", relocalised)

    def move_robot(self, pose: se2.Pose) -> None:
        """Move the robot between keyframes, without the scan of the last one."""
        translation, rotation = _transform(pose)
        self._writer.log_batched(
            "world/robot", rr.Transform3D, translation=translation, quaternion=rotation, max_age=MAX_BATCH_AGE
        )

    def place(self, pose: se2.Pose) -> None:
        """Move the robot and the last keyframe's scan to a pose in the map."""
        translation, rotation = _transform(pose)
        for entity in ("world/robot", "world/keyframe"):
            self._writer.log_batched(entity, rr.Transform3D, translation=translation, quaternion=rotation)
        self._writer.log_batched("world/here", rr.Transform3D, translation=translation)

    def correct(self, pose: se2.Pose, walls: MapWalls, corners: MapCorners) -> None:
        """Move the last keyframe with its features to its pose in a corrected map."""
        self.place(pose)
        if self._event is not None:
            self._event = replace(self._event, pose=pose)
            self._log_features(self._event, walls, corners)

    def clear(self) -> None:
        """Remove the last keyframe, which is in the map no more, for example as a lost robot was found again."""
        self._event = None
        for entity in ("world/keyframe", "world/features"):
            self._writer.clear(entity)

    def log_relocalisation(self, event: Relocalised, keyframe: int) -> None:
        """Draw the robot's outline at the pose of a relocalisation after a keyframe.

        The poses are those of the time of relocalisation; later corrections do not move them.
        """
        self._relocalisations.append(event.pose)
        outlines = np.stack([se2.transform(pose, ROBOT_OUTLINE) for pose in self._relocalisations])
        labels = [*([""] * (len(outlines) - 1)), f"relocalised after x{keyframe}"]
        strips = rr.LineStrips3D.from_fields(strips=to_3d(outlines, Height.DECISION), labels=labels)
        self._writer.log("world/relocalisations", strips)

    def log(
        self, event: KeyframeAdded, overlap_ratio: float, walls: MapWalls | None, corners: MapCorners | None
    ) -> float:
        """Log a keyframe and return the largest sigma of its position, metres, NaN if unknown.

        overlap_ratio   from the registration of its scan
        walls, corners  the map as last received
        """
        self._event = event
        position_sigma, heading_sigma = self._log_pose(event)
        self._log_features(event, walls, corners)
        self._log_time_series(event, overlap_ratio, position_sigma, heading_sigma)
        report = documents.keyframe(event, position_sigma, heading_sigma)
        self._writer.log_batched("keyframe", rr.TextDocument, text=[report], media_type=[rr.MediaType.MARKDOWN])
        return position_sigma

    def _log_pose(self, event: KeyframeAdded) -> tuple[float, float]:
        """Log robot, pose ellipse and scan.

        Returns the largest sigma of the position (metres) and the sigma of the heading (radians); NaN if unknown.
        """
        self.place(event.pose)
        covariance = event.pose_covariance
        centres, half_sizes, quaternions = ellipses(np.zeros((1, 2)), covariance[None, :2, :2], Height.SIGMA)
        self._writer.log_batched(
            "world/keyframe/sigma", rr.Ellipsoids3D, centers=centres, half_sizes=half_sizes, quaternions=quaternions
        )
        points = to_3d(event.points, Height.SCAN, SCAN_STEPS)
        self._writer.log_batched("world/keyframe/scan", rr.Points3D, positions=points)
        if not np.isfinite(covariance).all():
            return math.nan, math.nan
        variance = float(np.linalg.eigvalsh(covariance[:2, :2])[-1])
        return math.sqrt(max(variance, 0.0)), math.sqrt(max(float(covariance[2, 2]), 0.0))

    def _log_features(self, event: KeyframeAdded, walls: MapWalls | None, corners: MapCorners | None) -> None:
        ends = segment_ends(event.segments, event.pose)
        position = se2.transform(event.pose, event.corners.position.reshape(-1, 2))
        segments, points = FeatureMatches.of_segments(event), FeatureMatches.of_corners(event)
        self._writer.log_batched(
            "world/features/segments",
            rr.LineStrips3D,
            strips=to_3d(ends, Height.FEATURE),
            colors=_match_colours(segments),
            labels=segments.labels(),
        )
        self._writer.log_batched(
            "world/features/corners",
            rr.Points3D,
            positions=to_3d(position, Height.FEATURE),
            colors=_match_colours(points),
            labels=points.labels(),
        )
        for name, of_walls, of_points in (
            ("matched", segments.matched, points.matched),
            ("gated_out", segments.gated_out, points.gated_out),
        ):
            found = [np.empty((0, 2, 2))]
            if walls is not None:
                found.append(wall_links(ends.mean(axis=1), of_walls, walls))
            if corners is not None:
                found.append(corner_links(position, of_points, corners))
            links = to_3d(np.concatenate(found), Height.LINK)
            self._log_strips(f"world/features/{name}", links)

    def _log_strips(self, entity: str, strips: Float32s) -> None:
        """Log strips; an empty row only after one that was not empty."""
        if len(strips) or entity in self._non_empty:
            self._writer.log_batched(entity, rr.LineStrips3D, strips=strips)
        (self._non_empty.add if len(strips) else self._non_empty.discard)(entity)

    def _log_time_series(
        self, event: KeyframeAdded, overlap_ratio: float, position_sigma: float, heading_sigma: float
    ) -> None:
        distances = event.wall_gate[(event.wall_match >= 0) & np.isfinite(event.wall_gate)]
        sigma = {
            "position [cm]": 100 * position_sigma,
            "heading [°]": math.degrees(heading_sigma),
            "range [cm]": 100 * event.sigma_range,
        }
        self._time_series.log("overlap_ratio", {"overlap ratio": overlap_ratio})
        self._time_series.log("sigma", sigma)
        self._time_series.log("association", {"largest d²": float(distances.max()) if len(distances) else math.nan})
        self._time_series.log("time", {"total": sum(event.timings.values())} | event.timings)
        self._time_series.log("counts", event.counts)


def _transform(pose: se2.Pose) -> tuple[Floats, Floats]:
    """Return translation (1, 3) in metres and quaternion xyzw (1, 4) of a pose [x, y, heading]."""
    x, y, heading = (float(value) for value in pose)
    return np.array([[x, y, 0.0]]), np.array([[0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)]])


def _match_colours(matches: FeatureMatches) -> list[Colour]:
    return [
        colours.ODOMETRY if landmark_id < 0 else colours.NEW if new else colours.MATCHED
        for landmark_id, new in zip(matches.landmark_id.tolist(), matches.new.tolist(), strict=True)
    ]
