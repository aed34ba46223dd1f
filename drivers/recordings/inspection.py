"""What is in a recording, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .. import se2
from ..messages import Floats, GroundTruth, Odometry, Scan, Source, SourceReport

GAP = 4.0
"""A gap is longer than so many times what nine in ten periods are within (bursts are no gaps), and than LEAST_GAP."""
LEAST_GAP = 0.5
"""Seconds."""
FASTEST, FASTEST_TURN = 5.0, 10.0
"""m/s and rad/s that no robot in a building reaches; odometry that says more has jumped."""
SHORTEST_STEP = 0.02
"""Seconds. Between stamps that are closer than this their own jitter would look like a jump."""
JUMP, JUMP_TURN = 0.1, 0.2
"""Metres and radians; a smaller step is not a jump however short it took."""
MANY_INVALID = 0.5
"""Share of the beams."""


@dataclass(frozen=True, slots=True)
class Gap:
    """A pause without messages of a kind: when it began, and how long it lasted, seconds."""

    start: float
    duration: float


@dataclass(slots=True)
class RecordingInfo:
    """What a recording holds. Seconds, metres; rates in Hz; (min, max) pairs are None where there is nothing
    to tell.
    """

    name: str
    scans: int = 0
    odometry: int = 0
    ground_truth: int = 0
    start: float | None = None
    duration: float = 0.0
    scan_rate: float | None = None  # one over the median period
    odometry_rate: float | None = None
    beams: tuple[int, int] | None = None
    field_of_view: tuple[float, float] | None = None  # first and last angle, radians
    range_limits: tuple[float, float] | None = None  # what the sensor states
    ranges: tuple[float, float] | None = None  # the least and the greatest that were measured
    invalid_share: float | None = None  # of all beams
    time_offsets: tuple[float, float] | None = None  # of beams to their scan's stamp; (0, 0) where unknown
    mounts: list[tuple[float, float, float]] = field(default_factory=list)
    path_length: float = 0.0  # by odometry, its jumps left out
    scan_gaps: list[Gap] = field(default_factory=list)
    odometry_gaps: list[Gap] = field(default_factory=list)
    odometry_jumps: list[float] = field(default_factory=list)  # stamps
    report: SourceReport = field(default_factory=SourceReport)
    warnings: list[str] = field(default_factory=list)


@dataclass(slots=True)
class _Tally:
    """What is gathered about the scans while they pass."""

    stamps: list[float] = field(default_factory=list)
    beams: list[int] = field(default_factory=list)
    invalid: int = 0
    nearest: float = np.inf
    farthest: float = -np.inf
    offsets: tuple[float, float] = (np.inf, -np.inf)
    mounts: dict[bytes, tuple[float, float, float]] = field(default_factory=dict)
    without_mount: int = 0
    last: Scan | None = None

    def add(self, scan: Scan) -> None:
        self.stamps.append(scan.stamp)
        self.beams.append(len(scan.ranges))
        valid = scan.ranges[~np.isnan(scan.ranges)]
        self.invalid += len(scan.ranges) - len(valid)
        if len(valid):
            self.nearest = min(self.nearest, float(valid.min()))
            self.farthest = max(self.farthest, float(valid.max()))
        low, high = self.offsets
        self.offsets = min(low, float(scan.time_offsets.min())), max(high, float(scan.time_offsets.max()))
        if scan.mount is None:
            self.without_mount += 1
        elif (key := scan.mount.tobytes()) not in self.mounts:
            x, y, heading = scan.mount.tolist()
            self.mounts[key] = (x, y, heading)
        self.last = scan


def inspect(source: Source) -> RecordingInfo:
    """Read a source to its end and say what is in it; raises RecordingError where it cannot be read."""
    scans = _Tally()
    truth = 0
    stamps: list[float] = []
    poses: list[Floats] = []
    for message in source:
        if isinstance(message, Scan):
            scans.add(message)
        elif isinstance(message, Odometry):
            stamps.append(message.stamp)
            poses.append(message.pose)
        elif isinstance(message, GroundTruth):
            truth += 1
    info = RecordingInfo(source.name, len(scans.stamps), len(stamps), truth, report=source.report)
    _describe_scans(info, scans)
    times = np.array(stamps)
    _describe_odometry(info, times, np.array(poses).reshape(-1, 3))
    everything = np.concatenate([times, scans.stamps])
    if len(everything):
        info.start, info.duration = float(everything.min()), float(np.ptp(everything))
    info.warnings = _warnings(info, scans, times)
    return info


def _describe_scans(info: RecordingInfo, scans: _Tally) -> None:
    if scans.last is None:
        return
    info.scan_rate, info.scan_gaps = _rhythm(np.array(scans.stamps))
    info.beams = min(scans.beams), max(scans.beams)
    info.field_of_view = float(scans.last.angles[0]), float(scans.last.angles[-1])
    info.range_limits = scans.last.range_min, scans.last.range_max
    info.ranges = (scans.nearest, scans.farthest) if scans.farthest > 0 else None
    info.invalid_share = scans.invalid / sum(scans.beams)
    info.time_offsets = scans.offsets
    info.mounts = list(scans.mounts.values())


def _describe_odometry(info: RecordingInfo, stamps: Floats, poses: Floats) -> None:
    info.odometry_rate, info.odometry_gaps = _rhythm(stamps)
    if len(stamps) < 2:
        return
    steps = se2.between(poses[:-1], poses[1:])
    way, turn = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    elapsed = np.maximum(np.diff(stamps), SHORTEST_STEP)
    jumped = ((way > JUMP) & (way / elapsed > FASTEST)) | ((turn > JUMP_TURN) & (turn / elapsed > FASTEST_TURN))
    info.odometry_jumps = stamps[1:][jumped].tolist()
    info.path_length = float(way[~jumped].sum())


def _rhythm(stamps: Floats) -> tuple[float | None, list[Gap]]:
    """The rate, one over the median period, and the gaps."""
    periods = np.diff(stamps)
    going = periods[periods > 0]
    if not len(going):
        return None, []
    usual = float(np.percentile(going, 90, method="lower"))
    long = np.flatnonzero(periods > max(GAP * usual, LEAST_GAP))
    return 1.0 / float(np.median(going)), [Gap(float(stamps[i]), float(periods[i])) for i in long]


def _warnings(info: RecordingInfo, scans: _Tally, odometry: Floats) -> list[str]:
    """What a user should know, in plain words."""
    said: list[str] = []
    if not info.scans:
        said.append("no scans")
    if not info.odometry:
        said.append("no odometry")
    if info.scans and not info.mounts:
        said.append("the recording does not say where the lidar sits on the robot")
    elif scans.without_mount:
        said.append(f"{scans.without_mount} scans do not say where their lidar sits")
    if len(info.mounts) > 1:
        said.append(f"scans come from {len(info.mounts)} places on the robot")
    if info.beams and info.beams[0] != info.beams[1]:
        said.append(f"the number of beams changes between {info.beams[0]} and {info.beams[1]}")
    if info.invalid_share is not None and info.invalid_share > MANY_INVALID:
        said.append(f"{info.invalid_share:.0%} of the beams returned nothing valid")
    said += _about_offsets(info)
    said += _about_gaps("scans", info.scan_gaps)
    said += _about_gaps("odometry", info.odometry_gaps)
    if info.scans and info.odometry:
        said += _about_overlap(np.array(scans.stamps), odometry)
    if info.odometry_jumps:
        count, first = len(info.odometry_jumps), info.odometry_jumps[0]
        said.append(f"odometry jumps {count} times faster than any robot, first at {first:.3f}")
    if info.report.skipped:
        said.append(f"{info.report.skipped} entries were skipped, first {info.report.first}")
    said += [f"{reason} ({count} times)" for reason, count in info.report.reasons.items()]
    return said


def _about_offsets(info: RecordingInfo) -> list[str]:
    if info.time_offsets is None or info.scan_rate is None:
        return []
    low, high = info.time_offsets
    said = []
    if low < 0:
        said.append(f"beams are up to {-low:.3f} s older than their scan's stamp")
    if high > 1.5 / info.scan_rate:
        said.append(f"beams are up to {high:.3f} s after their scan's stamp, longer than a revolution")
    return said


def _about_gaps(what: str, gaps: list[Gap]) -> list[str]:
    if not gaps:
        return []
    longest = max(gaps, key=lambda gap: gap.duration)
    count = "a gap" if len(gaps) == 1 else f"{len(gaps)} gaps"
    return [f"{count} in the {what}, the longest {longest.duration:.1f} s at {longest.start:.3f}"]


def _about_overlap(scans: Floats, odometry: Floats) -> list[str]:
    """Stretches of scans before, after and between the odometry."""
    said = []
    if (lead := float(odometry[0] - scans[0])) > LEAST_GAP:
        said.append(f"scans without odometry for {lead:.1f} s at {scans[0]:.3f}")
    if (tail := float(scans[-1] - odometry[-1])) > LEAST_GAP:
        said.append(f"scans without odometry for {tail:.1f} s at {odometry[-1]:.3f}")
    after = np.searchsorted(odometry, scans)
    inside = (after > 0) & (after < len(odometry))
    wide = odometry[after[inside]] - odometry[after[inside] - 1]
    for start in np.unique(odometry[after[inside] - 1][wide > 10 * LEAST_GAP])[:3]:
        following = odometry[np.searchsorted(odometry, start, side="right")]
        said.append(f"scans without odometry for {following - start:.1f} s at {start:.3f}")
    return said
