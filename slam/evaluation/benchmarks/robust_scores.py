"""Score runs of SLAM, and raw odometry in the same way, by a reference and by the agreement of the scans.

Where there is a reference, errors are compared with it: relations, or a trajectory after rigid alignment. Without a
reference, the agreement of the scans along the path shows how well the drive was mapped. SLAM should never be worse
than odometry.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers import se2
from drivers.messages import Message, Odometry, Scan

from ...events import Finished
from ...geometry.segments import Floats
from ...io.tum import Trajectory, read_tum
from ...pipeline import Slam
from ...preprocessing.deskew import lidar_mount
from ..metrics import MIN_ALIGNED_PAIRS, read_relations, score_reference, score_relations
from ..scan_agreement import BeamTable
from .robust_drives import RELATIONS

WORSE = 1.05
"""Factor to odometry's value from which on a result is worse. Results of one drive scatter by some per cent if anything
changes."""


@dataclass(frozen=True, slots=True)
class PathScore:
    """Scores of one path.

    error      metres: mean of the relations, or RMS after alignment with a trajectory; NaN without a reference
    max_error  metres, largest error
    entropy, conflict  of the scans along the path, see `ScanAgreement`
    """

    error: float
    max_error: float
    entropy: float
    conflict: float


NO_SCORE = PathScore(math.nan, math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True)
class RobustResult:
    """Result of one drive.

    reference  origin of the reference: "relations", "gmapping", "truth", etc.; empty without one
    slam, odometry  scores of the path of SLAM and of raw odometry
    placed     share of the scans that have a pose
    lost       share of the scans taken while the robot was LOST
    suspects   sentences of the suspects
    cpu        processor time of the run, seconds, with reading or simulating
    failed     reason if there is no map
    """

    name: str
    reference: str = ""
    scans: int = 0
    duration: float = 0.0
    travelled: float = 0.0
    slam: PathScore = NO_SCORE
    odometry: PathScore = NO_SCORE
    placed: float = 0.0
    lost: float = 0.0
    closures: int = 0
    suspects: tuple[str, ...] = field(default=())
    cpu: float = 0.0
    failed: str = ""

    @property
    def worse(self) -> tuple[str, ...]:
        """Names of the scores that are worse than those of raw odometry by the factor WORSE."""
        names = ("error", "entropy", "conflict")
        return tuple(n for n in names if getattr(self.slam, n) > WORSE * getattr(self.odometry, n))

    def as_data(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        return asdict(self) | {"worse_than_odometry": self.worse}


def reference_errors(path: Trajectory, reference: Path) -> tuple[float, float]:
    """Return the error of a path, and the largest one, against relations or a reference trajectory in a file, metres.

    `path` has the recording's own stamps. The error is the mean over relations, or the RMS over a trajectory.
    """
    if reference.suffix == RELATIONS:
        translation = score_relations(path, read_relations(reference)).errors.translation
        return float(translation.mean()), float(translation.max())
    return trajectory_errors(path, read_tum(reference))


def trajectory_errors(path: Trajectory, reference: Trajectory) -> tuple[float, float]:
    """Return the RMS and the largest position error at the reference's stamps after rigid alignment, metres."""
    at = path.at(reference.stamps)
    if at.covered.sum() < MIN_ALIGNED_PAIRS:
        return math.nan, math.nan
    stamps = reference.stamps[at.covered]
    score = score_reference(Trajectory(stamps, at.poses[at.covered]), Trajectory(stamps, reference.poses[at.covered]))
    figures = score.figures()
    return figures["ate_rmse"], figures["ate_max"]


def trajectory_errors_in_map(
    path: Trajectory, reference: Trajectory, mapped: Trajectory, mapped_reference: Trajectory
) -> tuple[float, float]:
    """Return the RMS and the largest position error of a path in a map made from an earlier path, metres.

    `mapped` is the earlier path; its alignment with `mapped_reference` is that of the map with the references' frame.
    """
    if len(path) < MIN_ALIGNED_PAIRS:
        return math.nan, math.nan
    aligned = se2.compose(score_reference(mapped, mapped_reference).alignment, path.poses)
    errors = np.linalg.norm(aligned[:, :2] - reference.poses[:, :2], axis=1)
    return float(np.sqrt(np.mean(errors**2))), float(errors.max())


class ScoredRun:
    """One run of SLAM, with what is needed to score its path and that of odometry."""

    def __init__(self, slam: Slam, messages: Iterable[Message], after: float = -math.inf) -> None:
        """Give all messages to `slam` and finish it. Raises RecordingError or MapError.

        `after` is the latest stamp of a session that `slam` resumed, whose scans do not count.
        """
        self._after, self._beams = after, BeamTable()
        readings: list[Odometry] = []
        started = time.process_time()
        for message in messages:
            slam.add(message)
            if isinstance(message, Scan):
                mount = lidar_mount(message, slam.config.of_lidar(message.lidar))
                self._beams.add(replace(message, mount=mount))
            elif isinstance(message, Odometry):
                readings.append(message)
        self.finished: Finished = slam.finish()
        self._cpu = time.process_time() - started
        self._odometry = np.array([r.stamp for r in readings]), np.array([r.pose for r in readings])
        state = slam.slam_state
        self._placed = int((state.trajectory.at_scans(state.mapper.keyframe_poses)[0] > after).sum())

    @property
    def path(self) -> tuple[Floats, Floats]:
        """Stamps (n,) and estimated poses (n, 3)."""
        chosen = self.finished.stamps > self._after
        return self.finished.stamps[chosen], self.finished.poses[chosen]

    @property
    def odometry_path(self) -> tuple[Floats, Floats]:
        """Stamps (n,) and poses (n, 3) of raw odometry."""
        return self._odometry

    def _score(self, path: tuple[Floats, Floats], errors: tuple[float, float]) -> PathScore:
        """Return the score of a path; NO_SCORE for that of odometry if there is none."""
        if not len(path[0]):
            return NO_SCORE
        agreement = self._beams.agreement(Trajectory.sorted(*path))
        return PathScore(*errors, agreement.entropy, agreement.conflict)

    def result(self, name: str, reference: str, errors: Sequence[tuple[float, float]]) -> RobustResult:
        """Return the result, given the errors of the path and of odometry."""
        summary: dict[str, Any] = self.finished.summary
        path = Trajectory.sorted(*self.path)
        slam, raw = (self._score(one, own) for one, own in zip((self.path, self._odometry), errors, strict=True))
        return RobustResult(
            name=name,
            reference=reference,
            scans=self._beams.scans,
            duration=path.duration,
            travelled=path.length,
            slam=slam,
            odometry=raw,
            placed=self._placed / max(self._beams.scans, 1),
            lost=summary["health"]["lost"] / max(self._beams.scans, 1),
            closures=summary["loops"]["accepted"],
            suspects=tuple(suspect["sentence"] for suspect in summary["suspects"]),
            cpu=self._cpu,
        )
