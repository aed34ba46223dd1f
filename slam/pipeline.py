"""The story of a scan: straightened, condensed into walls and corners, laid over the map, and made part of it."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers import se2
from drivers.messages import GroundTruth, Message, Odometry, Scan

from .config import Config
from .errors import MapError
from .estimation.estimator import Estimator, ScanResult
from .estimation.map_view import finished, map_features
from .estimation.refinement import build_scan_history, match_trajectory, refine
from .estimation.relocalisation_session import KidnappingMonitor, RelocalisationSession
from .estimation.slam_state import KeyframeUpdate, SlamState
from .events import (
    Finished,
    GroundTruthReceived,
    MapCorners,
    MapWalls,
    Notice,
    Relocalised,
    ScanTracked,
    Sink,
    StateChanged,
)
from .geometry.segments import Floats
from .io.sessions import StoredSession
from .localisation.state import LocalisationMonitor, State
from .localisation.tracker import PoseFix, TrackingResult, TrackingStatus
from .loop_closure.closer import LoopCloser
from .mapping.mapper import Mapper
from .mapping.odometry_segments import OdometrySegments
from .preprocessing.preprocessor import Preprocessor, ProcessedScan
from .publisher import Publisher
from .run_statistics import RunStatistics, StageTimer
from .summary import run_summary


class Slam:
    """2-D SLAM with walls and corners. Feed it messages in time order, read the pose whenever you like, then finish.

    slam = Slam()
    for message in drivers.open("intel.clf"):
        slam.add(message)
    result = slam.finish()
    """

    def __init__(
        self,
        config: Config | None = None,
        sinks: Sequence[Sink] = (),
        *,
        refine: bool = False,
        keep_views: bool = False,
        loops: LoopCloser | None = None,
        resumed: StoredSession | None = None,
        frozen: bool = False,
    ) -> None:
        """`refine` asks for a second look at everything before finishing.

        For that, or to take it later, `keep_views` keeps what was sighted in familiar places, too, where nothing of it
        enters the map: memory then grows with the time driven. `loops` looks for loops in another way than the default.

        `resumed` is a session to go on from: straight on, if odometry continues, else from wherever in its map the
        robot is found. Where the map is `frozen` it stays as it is, and only the path on it is told.
        """
        self.config = config or Config()
        self._publisher = Publisher(sinks)
        self._front_end = Preprocessor(self.config, None if resumed is None else resumed.sigma_range)
        self._estimator = Estimator(SlamState(self.config.odometry, loops) if resumed is None else resumed.slam_state)
        self._drives = OdometrySegments() if resumed is None else OdometrySegments(resumed.odometry, resumed.starts)
        self._resumed, self._frozen = resumed, frozen
        self._front_end.wait([] if resumed is None else resumed.waiting)
        if frozen:
            self.slam_state.freeze()
        self._begun = False  # whether odometry has told of anything
        self._relocalisation: RelocalisationSession | None = None  # while the robot is lost
        self._kidnapping: KidnappingMonitor | None = None  # while what it sees may belong elsewhere
        self._refine, self._keep_views = refine, refine or keep_views
        self._familiar: set[int] = set()  # rows of the journal that were sighted in familiar places
        # everything sighted, for looking back at the end
        self._journal: list[ProcessedScan] = [] if resumed is None else list(resumed.scans)
        # what is of this run: the first row, and after when
        self._since = len(self._journal), -np.inf if resumed is None else resumed.latest
        self._state = LocalisationMonitor()
        self._statistics = RunStatistics()
        self._session: StoredSession | None = None

    # --- what goes in

    def add(self, message: Message) -> None:
        """Take the next message. A scan is worked on once the odometry covers its sweep."""
        if isinstance(message, GroundTruth):
            self._publisher.publish(GroundTruthReceived(message.stamp, message.pose))
            return
        if isinstance(message, Odometry) and not self._begun:
            self._begin(message)
        self._front_end.add(message)
        while (scan := self._front_end.next_scan()) is not None:
            self._add_scan(scan)

    def _begin(self, first: Odometry) -> None:
        """The first reading of odometry: it continues that of a session, or the robot may be anywhere on its map."""
        self._begun = True
        if self._resumed is None:
            self._front_end.odometry = self._drives.begin(0)
            return
        self._publisher.publish_map(first.stamp, self.slam_state.mapper)
        self._front_end.odometry = self._drives.histories[-1]
        if not self._drives.continue_with(first):
            self._work_off(len(self._resumed.waiting))
            self._front_end.odometry = self._drives.begin(len(self._journal))
            self._since = len(self._journal), self._since[1]
            self._relocalisation = RelocalisationSession(self.config.odometry, self.slam_state, (), kidnapped=True)
            self._publish_state(first.stamp, self._state.lose())

    # --- the story of a scan

    def _add_scan(self, scan: Scan) -> None:
        timer = StageTimer()
        processed = self._front_end.sight(scan, self.slam_state.odometry_model)
        timer.lap("features")
        self._journal.append(processed)
        if self._relocalisation is not None:
            self._look_for_the_way_back(self._relocalisation, processed)
            return
        step = self._estimator.take(processed, timer)
        if self.slam_state.in_familiar_place and not self._frozen:
            self._familiar.add(len(self._journal) - 1)
            if not self._keep_views:
                self._journal[-1] = processed.without_view()
        self._note(processed, step.tracking)
        if step.extension is not None:
            self._publish_keyframe(processed, step.mapper, step.extension, timer)
        if step.retracted is not None:
            self._statistics.add_loop(processed.stamp, step.retracted)
            self._publisher.publish_loop(step.retracted, processed.stamp, self.slam_state.mapper, step.mapper)
        self._suspect(processed, step)
        if self.slam_state.lost:
            slam_state = self.slam_state
            self._relocalisation = RelocalisationSession(
                self.config.odometry,
                slam_state,
                slam_state.unplaced,
                kidnapped=slam_state.view_changed or self._kidnapping is not None,
            )
            self._kidnapping = None
            self._publish_state(processed.stamp, self._state.lose())

    def _suspect(self, scan: ProcessedScan, step: ScanResult) -> None:
        """The view may have changed at a stroke: see for a while whether the robot is not somewhere else on the map."""
        if step.before is not None and self._kidnapping is None:
            self._kidnapping = KidnappingMonitor(self.config.odometry, step.before)
        if self._kidnapping is None:
            return
        self._kidnapping.add(scan, step.tracking)
        found = self._kidnapping.borne_out()
        if found is not None:
            self._found_again(found, scan.stamp, "carried away: found elsewhere in the map")
        elif self._kidnapping.over:
            self._kidnapping = None

    def _look_for_the_way_back(self, relocalisation: RelocalisationSession, scan: ProcessedScan) -> None:
        """The robot is lost: see whether what it has seen since is somewhere on the map."""
        relocalisation.add(scan)
        self._statistics.lost += 1
        found = relocalisation.recognised()
        if found is not None:
            self._found_again(found, scan.stamp, "found again in the map")
        elif relocalisation.over:
            text = "what is seen is not in the map where odometry has the robot; taken for a new place"
            self._go_on_from(relocalisation.joined(), scan.stamp, text)

    def _found_again(self, estimator: Estimator, stamp: float, text: str) -> None:
        self._publisher.publish(Relocalised(stamp, estimator.slam_state.pose.copy()))
        self._go_on_from(estimator, stamp, text)

    def _go_on_from(self, estimator: Estimator, stamp: float, text: str) -> None:
        self._estimator, self._relocalisation, self._kidnapping = estimator, None, None
        self._publisher.publish(Notice(stamp, text))
        self._publisher.publish_map(stamp, self.slam_state.mapper)
        self._publish_state(stamp, self._state.find())

    def _publish_state(self, stamp: float, state: State | None) -> None:
        if state is None:
            return
        self._statistics.states.append((stamp, state))
        self._publisher.publish(StateChanged(stamp, state.condition.value, state.direction))

    def _note(self, scan: ProcessedScan, tracking: TrackingResult) -> None:
        """Count how the scan was placed, and tell the listeners."""
        stamp, overlap_ratio = scan.stamp, tracking.registration.overlap_ratio
        self._statistics.overlap_ratio.append(overlap_ratio)
        if tracking.status is TrackingStatus.TENTATIVE:
            self._statistics.searched += 1
            self._publisher.publish(
                Notice(stamp, "odometry is far off; the pose was searched for and found in the map")
            )
        elif tracking.status is TrackingStatus.FAILED:
            self._statistics.unplaced += 1
            self._publisher.publish(Notice(stamp, "the scan fits nowhere near; left out"))
        elif tracking.status is TrackingStatus.NO_FEATURES:
            self._statistics.blind += 1
        self._publish_state(stamp, self._state.update(tracking))
        keyframe = self.slam_state.mapper.keyframe_count - 1
        self._publisher.publish(ScanTracked(stamp, tracking.pose, scan.odometry, overlap_ratio, keyframe))

    def _publish_keyframe(
        self, scan: ProcessedScan, mapper: Mapper, extension: KeyframeUpdate, timer: StageTimer
    ) -> None:
        """Count what the keyframe did to the map, and tell the listeners."""
        self._statistics.add_keyframe(timer)
        self._statistics.merged_walls += extension.merge is not None
        if extension.loop is not None:
            self._statistics.add_loop(scan.stamp, extension.loop)
        self._publisher.publish_keyframe(scan, mapper, extension, self._front_end.sigma_range, dict(timer.laps))

    # --- what comes out

    @property
    def slam_state(self) -> SlamState:
        """What is believed now, to look into: where the robot is, its path, the map under construction."""
        return self._estimator.slam_state

    @property
    def pose(self) -> se2.Pose:
        """The base's pose [x, y, heading] in the map at the last scan; see `state` for how well it is known."""
        return (self.slam_state if self._relocalisation is None else self._relocalisation).pose.copy()

    @property
    def state(self) -> State:
        """Whether the robot knows where it is."""
        return self._state.state

    @property
    def walls(self) -> MapWalls:
        """The walls as they are known now, without covariances: those cost time, `finish` gives them."""
        return map_features(self.slam_state.mapper, covariances=False)[0]

    @property
    def corners(self) -> MapCorners:
        """The corners as they are known now, without covariances."""
        return map_features(self.slam_state.mapper, covariances=False)[1]

    def finish(self) -> Finished:
        """Work off what waits, settle the estimate, and return path and map with the covariances of their marginals.

        Raises MapError where there was nothing to make a map of.
        """
        if not self._front_end.scans:
            raise MapError("no laser scan in it, so there is nothing to map")
        if not self._begun:
            raise MapError(f"{self._front_end.scans} scans, but no odometry; SLAM needs both")
        left = self._session_before_the_end()
        self._work_off()
        if self._relocalisation is not None:
            self._end_lost(self._relocalisation)
        self._session = left or self._stored(self.slam_state.copy())
        if not self._frozen:
            self._statistics.merged_walls += self.slam_state.mapper.settle()
        summary = run_summary(self._front_end, self.slam_state, self._statistics) | self._look_back()
        if self._refine:
            self._session = self._stored(self.slam_state)
        stamps, poses = self._drives.trajectory(self.slam_state.trajectory, self.slam_state.mapper.keyframe_poses)
        if self._frozen:
            stamps, poses = stamps[stamps > self._since[1]], poses[stamps > self._since[1]]
        self._publisher.publish_residuals(float(stamps[-1]), self.slam_state.mapper)
        result = finished(self.slam_state, (stamps, poses), summary)
        self._publisher.publish(result)
        return result

    def _work_off(self, count: int = sys.maxsize) -> None:
        """Take the scans that wait, or the first of them, without odometry to cover them."""
        while count > 0 and (scan := self._front_end.next_scan(last=True)) is not None:
            self._add_scan(scan)
            count -= 1

    def _session_before_the_end(self) -> StoredSession | None:
        """What is to be gone on from as if this had not been the end; None where that makes no difference, or where the
        end has yet to decide where the robot is."""
        waiting = self._front_end.waiting
        if self._relocalisation is not None or not waiting or not self.slam_state.mapper.keyframe_count:
            return None
        session = self._stored(self.slam_state.copy())
        session.scans, session.waiting = list(self._journal), waiting
        return session

    def _end_lost(self, relocalisation: RelocalisationSession) -> None:
        """The robot has not been found again before the end.

        Raises MapError where it never was on a map that is to stay as it is.
        """
        last = self._journal[-1].stamp
        if self._drives.starts[-1] < self._since[0] or self._resumed is None or self._placed_since():
            if not self._frozen:
                self._go_on_from(relocalisation.joined(), last, "never found again in the map; odometry has to do")
            self._relocalisation = None
            return
        if self._frozen:
            raise MapError("what was seen is nowhere on the map that it was to be found on")
        self._drives.keep_last()
        self._journal, self._resumed = self._journal[self._since[0] :], None
        alone = Estimator(SlamState(self.config.odometry))
        for scan in self._journal:
            step = alone.take(scan, StageTimer())
            decisions = [step.extension.loop if step.extension else None, step.retracted]
            for decision in decisions:
                if decision is not None:
                    self._statistics.add_loop(scan.stamp, decision)
        self._go_on_from(alone, last, "never found on the map of the session, and left alone: it is not in the results")

    def _placed_since(self) -> bool:
        """Whether anything of this run is on the path."""
        stamps = self.slam_state.trajectory.hung()[0]
        return bool(len(stamps)) and bool(stamps[-1] > self._since[1])

    @property
    def session(self) -> StoredSession:
        """All that the estimate consists of, to be kept and gone on from; known after `finish`."""
        assert self._session is not None, "ask after finish"
        return self._session

    def _stored(self, slam_state: SlamState) -> StoredSession:
        resumed = self._resumed
        return StoredSession(
            config=self.config,
            slam_state=slam_state,
            scans=self._journal,
            odometry=self._drives.histories,
            starts=self._drives.starts,
            sigma_range=self._front_end.sigma_range,
            recordings=[] if resumed is None else list(resumed.recordings),
            closures=[*(() if resumed is None else resumed.closures), *self._statistics.loops],
        )

    def _look_back(self) -> dict[str, object]:
        """Lay everything sighted over the finished map, after refining that if it is wanted; what the summary gets."""
        slam_state, last = self.slam_state, self._journal[-1].stamp
        if slam_state.mapper.keyframe_count < 2:
            return {}
        kidnapped, starts = slam_state.kidnapped_keyframes, self._drives.starts
        drive = build_scan_history(self._journal, slam_state.trajectory, slam_state.keyframe_stamps, kidnapped, starts)
        try:
            if not self._refine or self._frozen:
                # the same path whether or not what was sighted in familiar places has been kept
                known = [s.without_view() if row in self._familiar else s for row, s in enumerate(self._journal)]
                slam_state.trajectory = match_trajectory(
                    slam_state.mapper, replace(drive, scans=known), slam_state.odometry_model
                )
                return {}
            refined = refine(slam_state.mapper, drive, slam_state.odometry_model)
        except MapError as error:
            self._publisher.publish(Notice(last, f"what was seen is not looked back at: {error}"))
            return {}
        refined.mapper.remember_covariances()
        keyframes = {k: self._journal[row] for k, row in enumerate(drive.keyframes.tolist())}
        slam_state.settle_on(
            refined.mapper, refined.path, PoseFix(refined.poses[-1], self._journal[-1].odometry), keyframes
        )
        self._publisher.publish_map(last, slam_state.mapper)
        return {"refinement": refined.summary}

    def keyframe_covariance(self, index: int) -> Floats:
        """(3, 3): covariance of a keyframe's pose, in the keyframe's own frame (metres, metres, radians)."""
        return self.slam_state.mapper.keyframe_covariance(index)
