"""Checks that the header of a session fits to its tables, before anything is computed from them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...errors import MapError
from ...mapping.keyframes import KeyframeRecords
from ...odometry.history import OdometryHistory
from .agreement import agreement_state
from .header import AnchorRecord, SessionHeader
from .keyframes import are_reachable
from .scans import ScanRecords

ODOMETRY_MARGIN = 100.0
"""Metres by which odometry poses may be outside of the readings: they are between them, or shortly before and after."""


def check_header(
    file: Path,
    header: SessionHeader,
    scans: ScanRecords,
    records: KeyframeRecords,
    odometry: Sequence[OdometryHistory],
) -> None:
    """Raise MapError naming `file`, the header, if a keyframe, scan or odometry segment that it refers to does not
    exist, or if its numbers contradict the tables.
    """
    count = len(scans.keyframe_stamps)
    _check_keyframes(file, header, count)
    _check_parts(file, header, count)
    _check_tracker(file, header, scans)
    _check_places(file, header, records)
    _check_odometry(file, header, scans, odometry)
    starts = header.segment_starts
    if len(starts) != len(odometry) or starts[:1] not in ([], [0]):
        raise MapError(f"{file}: segment_starts: these are not the starts of {len(odometry)} odometry segments")
    if (starts and starts[-1] > len(scans.scans)) or any(start > end for start, end in pairwise(starts)):
        raise MapError(f"{file}: segment_starts: these are no rows of {len(scans.scans)} scans in their order")


def _check_keyframes(file: Path, header: SessionHeader, count: int) -> None:
    """Raise MapError if a keyframe that is referred to is none of `count`."""
    checkpoint = header.checkpoint
    if (checkpoint.anchor is None) != (count == 0):
        raise MapError(f"{file}: checkpoint.anchor: must be stated if and only if there are keyframes")
    references: list[tuple[str, Iterable[int]]] = [
        *((name, [anchor.keyframe]) for name, anchor in _anchors(header).items()),
        ("checkpoint.kidnapped_keyframes", checkpoint.kidnapped_keyframes),
        ("checkpoint.field", checkpoint.field.keyframes),
        ("agreement", agreement_state(header.agreement).keyframes),
        *(("joins", agreement_state(record).keyframes) for record in header.joins.values()),
    ]
    for name, keyframes in references:
        if any(not 0 <= keyframe < count for keyframe in keyframes):
            raise MapError(f"{file}: {name}: there are {count} keyframes")


def _check_parts(file: Path, header: SessionHeader, count: int) -> None:
    """Raise MapError if the parts of the map are not parts of `count` keyframes."""
    parts = header.map_parts
    if (
        parts.firsts[0] != 0
        or parts.groups[0] != 0
        or any(a >= b for a, b in pairwise(parts.firsts))
        or parts.firsts[-1] > count
    ):
        raise MapError(f"{file}: parts: these are not parts of {count} keyframes in their order")
    if any(group > part or parts.groups[group] != group for part, group in enumerate(parts.groups)):
        raise MapError(f"{file}: parts: a part is joined with a part that does not exist")


def _check_tracker(file: Path, header: SessionHeader, scans: ScanRecords) -> None:
    """Raise MapError if the state of the tracker contradicts itself or the scans."""
    tracker = header.checkpoint.tracker
    if tracker is None:
        return
    if tracker.slips > tracker.scans:
        raise MapError(f"{file}: checkpoint.tracker: more slips than scans")
    if not tracker.repeated_slips <= tracker.after_slips <= tracker.slips:
        raise MapError(
            f"{file}: checkpoint.tracker: the numbers of scans after slips and of slips contradict each other"
        )
    if tracker.moved_objects > tracker.objects:
        raise MapError(f"{file}: checkpoint.tracker: more small objects have moved than were seen")
    latest = scans.scans.stamps[-1] if len(scans.scans) else -math.inf
    if tracker.scan_stamp is not None and tracker.scan_stamp > latest:
        raise MapError(f"{file}: checkpoint.tracker: the last scan is later than all scans")


def _check_places(file: Path, header: SessionHeader, records: KeyframeRecords) -> None:
    """Raise MapError if the robot was, or is, where it cannot have driven to."""
    checkpoint, keyframes = header.checkpoint, records.keyframe_poses
    if not len(keyframes):
        return
    tracker, field = checkpoint.tracker, checkpoint.field
    places = {"checkpoint.field": [field.centre, *field.inserted_poses]}
    if field.successor is not None:
        places["checkpoint.field.successor"] = [field.successor.centre, *field.successor.poses]
    if tracker is not None:
        places["checkpoint.tracker"] = [tracker.fix.pose, tracker.reference.pose]
    for name, poses in places.items():
        positions = np.array([pose[:2] for pose in poses])
        if not are_reachable(positions, keyframes[0, :2], records.travelled):
            raise MapError(f"{file}: {name}: is farther away than the robot can have driven")


def _check_odometry(file: Path, header: SessionHeader, scans: ScanRecords, odometry: Sequence[OdometryHistory]) -> None:
    """Raise MapError if an odometry pose of the scans, or of the header, is far from all readings."""
    checkpoint, readings = header.checkpoint, [history.poses[:, :2] for history in odometry]
    poses = [scans.scans.odometry, *(np.array([anchor.odometry]) for anchor in _anchors(header).values())]
    if checkpoint.tracker is not None:
        poses += [np.array([fix.odometry]) for fix in (checkpoint.tracker.fix, checkpoint.tracker.reference)]
    if not readings:
        return
    all_readings, all_poses = np.concatenate(readings), np.concatenate(poses)[:, :2]
    low, high = all_readings.min(axis=0) - ODOMETRY_MARGIN, all_readings.max(axis=0) + ODOMETRY_MARGIN
    if not ((all_poses > low) & (all_poses < high)).all():
        raise MapError(f"{file}: an odometry pose of a scan, or of the last ones, is far from all readings")


def _anchors(header: SessionHeader) -> dict[str, AnchorRecord]:
    """Return the anchors that there are, by name."""
    checkpoint = header.checkpoint
    both = {"checkpoint.anchor": checkpoint.anchor, "checkpoint.learned_until": checkpoint.learned_until}
    return {name: anchor for name, anchor in both.items() if anchor is not None}
