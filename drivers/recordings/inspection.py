"""Summary of a recording: contents, rates and problems, as shown by `wclm info`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .. import se2
from ..arguments import check_type
from ..elapsed import elapsed
from ..gaps import Gap, UnseenStretch, gap_warnings, rate_and_gaps, unseen_stretches
from ..messages import Floats, GroundTruth, Odometry, Scan, Source, SourceReport, YawRate
from ..path_length import path_length
from .odometry_speed import MIN_INTERVAL

MAX_SPEED, MAX_TURN_RATE = 5.0, 10.0
"""m/s and rad/s. Faster odometry than any indoor robot is a jump."""
MIN_JUMP, MIN_JUMP_TURN = 0.1, 0.2
"""Metres and radians; smaller steps are not jumps at any speed."""
MAX_INVALID_SHARE = 0.5
"""Share of the beams; above it there is a warning."""
MAX_REPEATED_SHARE = 0.1
"""Share of the scans that have the stamp of the one before; above it, stamps are coarser than scans are frequent."""


@dataclass(slots=True)
class RecordingInfo:
    """Contents of a recording. Units: seconds, metres, Hz; (min, max) pairs are None if there are no data."""

    name: str
    scans: int = 0
    odometry: int = 0
    yaw_rates: int = 0  # of a gyroscope
    ground_truth: int = 0
    start: float | None = None
    duration: float = 0.0
    scan_rate: float | None = None  # mean rate outside of gaps, as the other rates
    repeated_stamps: float = 0.0  # share of the scans that have the stamp of the one before
    odometry_rate: float | None = None
    gyroscope_rate: float | None = None
    beams: tuple[int, int] | None = None
    field_of_view: tuple[float, float] | None = None  # first and last angle, radians
    range_limits: tuple[float, float] | None = None  # as stated by the sensor
    ranges: tuple[float, float] | None = None  # smallest and largest measured range
    invalid_share: float | None = None  # of all beams
    intensities: tuple[float, float] | None = None  # of the returns, in the lidar's own unit
    time_offsets: tuple[float, float] | None = None  # of beams after the stamp in most scans; (0, 0) if unknown
    mounts: list[tuple[float, float, float]] = field(default_factory=list)
    path_length: float = 0.0  # by odometry, without its jumps
    scan_gaps: list[Gap] = field(default_factory=list)
    odometry_gaps: list[Gap] = field(default_factory=list)
    odometry_jumps: list[float] = field(default_factory=list)  # stamps
    unseen: list[UnseenStretch] = field(default_factory=list)  # of odometry, before the first and after the last scan
    report: SourceReport = field(default_factory=SourceReport)
    warnings: list[str] = field(default_factory=list)


@dataclass(slots=True)
class _ScanStatistics:
    """Statistics of the scans, accumulated scan by scan."""

    stamps: list[float] = field(default_factory=list)
    beams: list[int] = field(default_factory=list)
    invalid: int = 0
    nearest: float = np.inf
    farthest: float = -np.inf
    offsets: list[tuple[float, float]] = field(default_factory=list)
    mounts: dict[bytes, tuple[float, float, float]] = field(default_factory=dict)
    without_mount: int = 0
    weakest: float = np.inf
    strongest: float = -np.inf
    last: Scan | None = None

    def add(self, scan: Scan) -> None:
        self.stamps.append(scan.stamp)
        self.beams.append(len(scan.ranges))
        valid = scan.ranges[~np.isnan(scan.ranges)]
        self.invalid += len(scan.ranges) - len(valid)
        if len(valid):
            self.nearest = min(self.nearest, float(valid.min()))
            self.farthest = max(self.farthest, float(valid.max()))
        if scan.intensities is not None:
            strengths = scan.intensities[~np.isnan(scan.ranges) & np.isfinite(scan.intensities)]
            self.weakest = min(self.weakest, float(strengths.min(initial=np.inf)))
            self.strongest = max(self.strongest, float(strengths.max(initial=-np.inf)))
        self.offsets.append((float(scan.time_offsets.min()), float(scan.time_offsets.max())))
        if scan.mount is None:
            self.without_mount += 1
        elif (key := scan.mount.tobytes()) not in self.mounts:
            x, y, heading = scan.mount.tolist()
            self.mounts[key] = (x, y, heading)
        self.last = scan


def inspect(source: Source) -> RecordingInfo:
    """Read a source to its end and summarise it; raises RecordingError if it cannot be read."""
    check_type("source", source, Source, "a source, as drivers.open returns")
    scans = _ScanStatistics()
    truth = 0
    stamps: list[float] = []
    poses: list[Floats] = []
    yaw_rates: list[float] = []
    for message in source:
        if isinstance(message, Scan):
            scans.add(message)
        elif isinstance(message, Odometry):
            stamps.append(message.stamp)
            poses.append(message.pose)
        elif isinstance(message, YawRate):
            yaw_rates.append(message.stamp)
        elif isinstance(message, GroundTruth):
            truth += 1
    info = RecordingInfo(
        source.name, len(scans.stamps), len(stamps), len(yaw_rates), ground_truth=truth, report=source.report
    )
    info.gyroscope_rate, _ = rate_and_gaps(np.array(yaw_rates))
    _describe_scans(info, scans)
    times = np.array(stamps)
    _describe_odometry(info, times, np.array(poses).reshape(-1, 3), np.array(scans.stamps))
    everything = np.concatenate([times, scans.stamps])
    if len(everything):
        info.start, info.duration = float(everything.min()), float(np.ptp(everything))
    info.warnings = _warnings(info, scans, times)
    return info


def _describe_scans(info: RecordingInfo, scans: _ScanStatistics) -> None:
    if scans.last is None:
        return
    stamps = np.array(scans.stamps)
    info.scan_rate, info.scan_gaps = rate_and_gaps(stamps)
    info.repeated_stamps = float(np.mean(np.diff(stamps) == 0.0)) if len(stamps) > 1 else 0.0
    info.beams = min(scans.beams), max(scans.beams)
    info.field_of_view = float(scans.last.angles[0]), float(scans.last.angles[-1])
    info.range_limits = scans.last.range_min, scans.last.range_max
    info.ranges = (scans.nearest, scans.farthest) if scans.farthest > 0 else None
    info.invalid_share = scans.invalid / sum(scans.beams)
    info.intensities = (scans.weakest, scans.strongest) if scans.strongest >= scans.weakest else None
    low, high = np.median(scans.offsets, axis=0).tolist()  # a lidar that starts has slower revolutions
    info.time_offsets = low, high
    info.mounts = list(scans.mounts.values())


def _describe_odometry(info: RecordingInfo, stamps: Floats, poses: Floats, scans: Floats) -> None:
    info.odometry_rate, info.odometry_gaps = rate_and_gaps(stamps)
    if len(stamps) < 2:
        return
    steps = se2.between(poses[:-1], poses[1:])
    distance, turn = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    elapsed = np.maximum(np.diff(stamps), MIN_INTERVAL)
    jumped = ((distance > MIN_JUMP) & (distance / elapsed > MAX_SPEED)) | (
        (turn > MIN_JUMP_TURN) & (turn / elapsed > MAX_TURN_RATE)
    )
    info.odometry_jumps = stamps[1:][jumped].tolist()
    displacements = np.where(jumped[:, None], 0.0, np.diff(poses[:, :2], axis=0))
    positions = np.concatenate([[[0.0, 0.0]], np.cumsum(displacements, axis=0)])
    info.path_length = path_length(positions)
    info.unseen = unseen_stretches(scans, stamps, positions)


def _warnings(info: RecordingInfo, scans: _ScanStatistics, odometry: Floats) -> list[str]:
    """Return one line of text for each problem that a user should know of, with times since the recording's start."""
    warnings: list[str] = []
    start = info.start or 0.0
    if not info.scans:
        warnings.append("no scans")
    if not info.odometry:
        warnings.append("no odometry: the motion comes from the scans alone")
    if info.mounts and scans.without_mount:
        warnings.append(f"{_count(scans.without_mount, 'scan')} without a lidar mount")
    if len(info.mounts) > 1:
        warnings.append(f"scans come from {len(info.mounts)} different lidar mounts")
    if info.invalid_share is not None and info.invalid_share > MAX_INVALID_SHARE:
        warnings.append(f"{100.0 * info.invalid_share:.0f} % of the beams have no return")
    if info.repeated_stamps > MAX_REPEATED_SHARE:
        share = f"{100.0 * info.repeated_stamps:.0f} % of the scans have the stamp of the scan before"
        seconds = ", and all are whole seconds" if not np.any(np.mod(scans.stamps, 1.0)) else ""
        warnings.append(f"{share}{seconds}: stamps are coarser than scans are frequent")
    warnings += _offset_warnings(info)
    warnings += gap_warnings(np.array(scans.stamps), odometry)
    for one in info.unseen:
        driven = f"in which the robot drives {one.length:.1f} m"
        warnings.append(f"odometry without scans for {one.duration:.1f} s at {elapsed(one.start - start)}, {driven}")
    if info.odometry_jumps:
        count, first = len(info.odometry_jumps), info.odometry_jumps[0]
        limits = f"{MAX_SPEED:g} m/s or {MAX_TURN_RATE:g} rad/s"
        unit = "; is it in millimetres or degrees?" if 2 * count > info.odometry else ""
        jumps, when = f"{_count(count, 'jump')} of the odometry", f"first at {elapsed(first - start)}"
        warnings.append(f"{jumps}, faster than {limits}, {when}{unit}")
    warnings += info.report.doubts
    if info.report.skipped:
        warnings.append(f"{_count(info.report.skipped, 'entry', 'entries')} skipped, first {info.report.first}")
    if len(info.report.reasons) > 1:  # the first one is stated
        warnings += [f"{reason} ({_count(count, 'time')})" for reason, count in info.report.reasons.items()]
    return warnings


def _offset_warnings(info: RecordingInfo) -> list[str]:
    if info.time_offsets is None or info.scan_rate is None:
        return []
    low, high = info.time_offsets
    warnings = []
    if low < 0:
        warnings.append(f"beams are measured up to {-low:.3f} s before their scan's stamp")
    if high > 1.5 / info.scan_rate:
        warnings.append(
            f"beams are measured up to {high:.3f} s after their scan's stamp, which is longer than a revolution"
        )
    return warnings


def _count(number: int, singular: str, plural: str | None = None) -> str:
    """Return a number with its noun, `1 gap` or `3 gaps`."""
    return f"{number} {singular if number == 1 else plural or singular + 's'}"
