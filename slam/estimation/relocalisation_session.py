"""Finding the way back: a lost robot maps what is around it by itself, until that is recognised in its old map.

It may have been carried away, or have seen nothing for so long that odometry has led astray. Nothing enters the old map
in the meantime. Once the place is recognised, the sightings since are taken as if the robot had known it all along.

Places may look alike. A robot that was carried away has seen what is around it change at a stroke; it may be anywhere.
One that has not is where odometry has it, as well as that is known: if it is not found there, the place is a new one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from drivers import se2

from ..config import OdometryConfig
from ..localisation.tracker import TrackingResult, TrackingStatus
from ..loop_closure.relocalisation import Relocalisation, index_map, relocalise, submap_of
from ..loop_closure.verification import allowed_by_estimate
from ..preprocessing.preprocessor import ProcessedScan
from ..run_statistics import StageTimer
from .estimator import Estimator
from .slam_state import SlamState

LOOK_KEYFRAMES, LOOK_WAY = 3, 1.0  # keyframes and metres of driving between two looks
ENOUGH_LOOKS = 4  # looks in a row that find the same place, other places being close behind, for it to be believed
SAME_PLACE, SAME_HEADING = 0.3, math.radians(3.0)  # by which they may differ
SUSPICION_WAY = 10.0  # metres of driving
CLEARLY_MORE = 0.05  # share of the wall length seen that must fall on known walls more than where it was believed to be
ODOMETRY_WAY = 10.0  # metres of driving in which a robot that was not carried must be found near where odometry has it
LEAST_PLACED = 0.8  # share of the sightings since getting lost that must fit the map where they are believed to belong


class RelocalisationSession:
    """The sightings since the robot got lost, and the small map of its own that they make.

    `whole` is the belief before that. It is never changed; what comes of the excursion is a new one. `carried` is
    whether the robot may have been carried away.
    """

    def __init__(
        self, config: OdometryConfig, whole: SlamState, scans: Sequence[ProcessedScan], *, kidnapped: bool
    ) -> None:
        self._config = config
        self._whole, self._kidnapped = whole, kidnapped
        self._index = index_map(whole.mapper)
        self._start(scans)

    def _start(self, scans: Sequence[ProcessedScan]) -> None:
        self._estimator = Estimator(SlamState(self._config))
        self._looked_keyframe, self._looked_way = 0, -LOOK_WAY
        self._likely: list[se2.Pose] = []  # where the last looks in a row have the excursion's frame in the old map
        self.scans: list[ProcessedScan] = []
        self.overlap_ratio: list[float] = []  # of them, in the place that was recognised last
        for scan in scans:
            self.add(scan)

    def add(self, scan: ProcessedScan) -> None:
        """Take a sighting. If the last ones do not fit those before, the robot got lost again: all starts anew."""
        self._estimator.take(scan, StageTimer())
        self.scans.append(scan)
        if self._estimator.slam_state.lost:
            self._kidnapped = self._kidnapped or self._estimator.slam_state.view_changed
            self._start(self._estimator.slam_state.unplaced)

    @property
    def travel(self) -> float:
        """Metres driven since."""
        return self._estimator.slam_state.mapper.travelled[-1]

    @property
    def pose(self) -> se2.Pose:
        """Where odometry has the base in the old map, which is all that is known."""
        return self._whole.predict(self.scans[-1].odometry)

    @property
    def over(self) -> bool:
        """Whether it is no use to look any longer: the robot is where odometry has it, and that is no known place."""
        return not self._kidnapped and not self._whole.frozen and self.travel > ODOMETRY_WAY

    def recognised(self) -> Estimator | None:
        """The old map with the excursion's sightings where they belong on it; None if that is not known yet."""
        mapper = self._estimator.slam_state.mapper
        count, travel = mapper.keyframe_count, mapper.travelled[-1]
        if count - self._looked_keyframe < LOOK_KEYFRAMES or travel - self._looked_way < LOOK_WAY:
            return None
        self._looked_keyframe, self._looked_way = count, travel
        found = relocalise(submap_of(mapper), self._index)
        if found is None or not self._believed(found) or not self._possible(found):
            return None
        return self._at(found.motion)

    def _possible(self, found: Relocalisation) -> bool:
        """Whether the robot can have come there: carried anywhere, by itself as far as odometry may lead astray."""
        if self._kidnapped:
            return True
        odometry = self.scans[0].odometry
        seen = self._whole.mapper.landmarks.walls.rows["last_seen"][found.pairs[:, 0]]
        covariance = self._whole.covariance_since(int(np.bincount(seen).argmax()), odometry)
        return allowed_by_estimate(se2.between(self._whole.predict(odometry), found.motion), covariance).passed

    def _believed(self, found: Relocalisation) -> bool:
        """Whether a place is accepted at once, or has been the likeliest often enough while more and more was seen."""
        apart = [se2.between(before, found.motion) for before in self._likely]
        same = all(np.hypot(x, y) < SAME_PLACE and abs(turn) < SAME_HEADING for x, y, turn in apart)
        self._likely = [*(self._likely if same else []), found.motion] if found.verdict.likely else []
        return found.verdict.accepted or len(self._likely) >= ENOUGH_LOOKS

    def _at(self, motion: se2.Pose) -> Estimator | None:
        """The old map with the excursion's sightings there, if they fit."""
        slam_state = self._whole.copy()
        slam_state.move_to(motion, self.scans[0].odometry)  # the excursion's frame is its first sighting's
        recovered, placed = self._taken_from(slam_state)
        self.overlap_ratio = [tracking.registration.overlap_ratio for tracking in placed]
        fitting = sum(tracking.status is not TrackingStatus.FAILED for tracking in placed)
        return recovered if fitting >= LEAST_PLACED * len(placed) and not recovered.slam_state.lost else None

    def joined(self) -> Estimator:
        """The old map with the excursion's sightings where odometry has them, for want of anything better.

        The uncertainty of that is in the covariances.
        """
        slam_state = self._whole.copy()
        slam_state.start_anew(self.scans[0].odometry, kidnapped=self._kidnapped)
        return self._taken_from(slam_state)[0]

    def _taken_from(self, slam_state: SlamState) -> tuple[Estimator, list[TrackingResult]]:
        """The excursion's sightings taken from a belief on, and how each was placed."""
        estimator = Estimator(slam_state)
        return estimator, [estimator.take(scan, StageTimer()).tracking for scan in self.scans]


class KidnappingMonitor:
    """Whether the robot has been carried to a place that looks much like the one where it is believed to be.

    What it sees has changed at a stroke. It goes on as before; but if what it sees from then on belongs elsewhere on
    the map, and fits better there, that is where it is.
    """

    def __init__(self, config: OdometryConfig, before: SlamState) -> None:
        self._excursion = RelocalisationSession(config, before, (), kidnapped=True)
        self._explained: list[float] = []  # where the robot is believed to be

    def add(self, scan: ProcessedScan, tracking: TrackingResult) -> None:
        """Take a sighting, and where it was placed."""
        self._excursion.add(scan)
        self._explained.append(tracking.registration.overlap_ratio)

    @property
    def over(self) -> bool:
        """Whether the robot has driven far enough for it to be unfounded."""
        return self._excursion.travel > SUSPICION_WAY

    def borne_out(self) -> Estimator | None:
        """The map with the sightings since where they belong, if that is elsewhere."""
        found = self._excursion.recognised()
        if found is None:
            return None
        better = np.mean(self._excursion.overlap_ratio) > np.mean(self._explained) + CLEARLY_MORE
        return found if better else None
