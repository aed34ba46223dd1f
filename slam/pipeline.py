"""SLAM from messages to map: `Slam.add` takes the messages, `Slam.finish` returns map and trajectory."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers import se2
from drivers.messages import GroundTruth, InitialPose, Message, Odometry, Scan, YawRate, delay_odometry

from .checks import find_suspects
from .checks.adapter import drive_of, unconnected_parts, unconstrained_stretches
from .config import Config
from .errors import MapError, SlamError
from .estimation.estimator import Estimator, ScanResult
from .estimation.journal import Journal
from .estimation.map_view import final_result, map_features
from .estimation.refinement import match_trajectory, refine
from .estimation.slam_state import SlamState
from .estimation.stage_timer import StageTimer
from .events import Finished, GroundTruthReceived, Notice, Relocalised, Sink
from .geometry.segments import Floats
from .io.sessions import StoredSession
from .localisation.state import LocalisationEvent, LocalisationState, LocalisationStateMachine
from .localisation.tracker import PoseFix, TrackingResult, TrackingStatus
from .loop_closure.agreement import LoopAgreement
from .mapping.map_features import MapCorners, MapWalls
from .odometry.constant_velocity import ConstantVelocity
from .odometry.error_model import UNOBSERVED_SIGMA
from .odometry.gyroscope import Gyroscope, GyroscopeOdometry
from .odometry.predicted_motion import BLIND_SIGMA
from .preprocessing.preprocessor import Preprocessor, ProcessedScan
from .publisher import Publisher
from .run_snapshot import RunSnapshot
from .run_statistics import RunStatistics, run_summary


class Slam:
    """2-D SLAM with walls and corners: add messages in time order, read the pose at any time, then finish.

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
        keep_all_features: bool = False,
        loops: LoopAgreement | None = None,
        resumed: StoredSession | None = None,
        frozen: bool = False,
        start: se2.Pose | None = None,
    ) -> None:
        """Create an empty map, or continue a session.

        refine             refine the whole map offline in `finish`
        keep_all_features  keep the features of scans in familiar places too, so that the session can be refined later;
                           memory then grows with time. Implied by `refine`
        loops              search for loop closures in another way than the default
        resumed            session to continue: directly if odometry is continuous, else after relocalisation in its map
        frozen             keep the map of the session unchanged and only estimate the trajectory in it
        start              roughly known pose [x, y, heading] of the base in the map of the session at the first scan;
                           without it the robot may be anywhere
        """
        self._initial_pose = start
        self.config = config or Config()
        self._refine, self._frozen = refine, frozen
        self._resumed = resumed
        self._publisher = Publisher(sinks)
        self._statistics = RunStatistics()
        predicted = self.config.odometry.source == "none"
        self._localisation = LocalisationStateMachine(BLIND_SIGMA if predicted else UNOBSERVED_SIGMA)
        self._has_odometry = False
        self._session: StoredSession | None = None
        self._gyroscope = Gyroscope()
        self._turning = GyroscopeOdometry(self._gyroscope)
        self._velocity = ConstantVelocity(self._gyroscope) if predicted else None
        self._preprocessor = Preprocessor(self.config, None if resumed is None else resumed.sigma_range)
        keep = refine or keep_all_features
        if resumed is None:
            self._estimator = Estimator(SlamState(self.config, loops))
            self._journal = Journal(keep_all_features=keep)
        else:
            if resumed.config.odometry.source != self.config.odometry.source:
                resumed.slam_state.replace_odometry(self.config)
            mapper = resumed.slam_state.mapper
            mapper.gauge.hold(mapper)
            self._estimator = Estimator(resumed.slam_state)
            self._journal = Journal(
                resumed.scans, resumed.odometry, resumed.starts, resumed.latest, keep_all_features=keep
            )
            self._preprocessor.restore_queue(resumed.queued_scans)
        if frozen:
            self.slam_state.freeze()

    # --- input

    def add(self, message: Message) -> None:
        """Add the next message. A scan is processed once odometry covers its sweep.

        Scans must come in the order of their stamps, and odometry too; a scan may come after later odometry.
        """
        message = delay_odometry(message, self.config.lidar.delay or 0.0)
        if isinstance(message, GroundTruth):
            self._publisher.publish(GroundTruthReceived(message.stamp, message.pose))
            return
        if isinstance(message, InitialPose):
            self._initial_pose = message.pose
        elif isinstance(message, YawRate):
            if self.config.odometry.gyroscope:
                self._gyroscope.add(message)
        elif self._velocity is None:
            self._add_measurement(self._turning.combined(message) if isinstance(message, Odometry) else message)
        elif isinstance(message, Scan):
            for reading in self._velocity.readings(message):
                self._add_measurement(reading)
            self._add_measurement(message)

    def _add_measurement(self, message: Scan | Odometry) -> None:
        """Add a scan, or measured or predicted odometry; process the scans that it covers."""
        if isinstance(message, Odometry) and not self._has_odometry:
            self._start(message)
        self._preprocessor.add(message)
        while (scan := self._preprocessor.next_scan()) is not None:
            self._process_scan(scan)

    def _process_scan(self, scan: Scan) -> None:
        """De-skew a scan, extract features, track the pose, update the map, and publish the results."""
        timer = StageTimer()
        processed = self._preprocessor.process(scan, self.slam_state.odometry_model)
        timer.lap("features")
        self._journal.add(processed)
        before = self._estimator.state.matched_pose
        if self._initial_pose is not None:
            self._place(processed, self._initial_pose)
            before = None
        result = self._estimator.process(processed, timer)
        motion, covariance = _motion_since(before, result.tracking)
        turn = None if motion is None else float(motion[2])
        self._gyroscope.correct(processed.stamp, turn, float(covariance[2, 2]))
        if self._velocity is not None:
            self._velocity.correct(motion, covariance)
            result = replace(result, tracking=replace(result.tracking, slipped=False))  # there is nothing that can slip
        if self.slam_state.in_familiar_place and not self._frozen:
            self._journal.mark_last_familiar()
        self._statistics.add_tracking(result.tracking)
        self._statistics.lost_scans += self._localisation.lost
        self._publisher.publish_tracking(processed, result.tracking, self.slam_state.mapper)
        if result.update is not None:
            self._statistics.add_keyframe(processed.stamp, result.update, timer)
            self._publisher.publish_keyframe(
                processed, result.mapper, result.update, self._preprocessor.sigma_range, timer
            )
            self._report_rejected_loops(processed.stamp)
        if result.retracted is not None:
            self._statistics.add_loop(processed.stamp, result.retracted)
            self._publisher.publish_loop(result.retracted, processed.stamp, self.slam_state.mapper, result.mapper)
        self._update_localisation(processed.stamp, result)

    def _report_rejected_loops(self, stamp: float, *, ended: bool = False) -> None:
        """Count and publish the hypotheses of loops that were given up; if the run has `ended`, also all others."""
        state = self.slam_state
        for decision in state.loops.take_rejected(ended=ended):
            self._statistics.add_loop(state.keyframe_stamps[decision.keyframe], decision)
            self._publisher.publish_rejected_loop(decision, stamp, state.mapper)

    # --- localisation state

    def _start(self, first: Odometry) -> None:
        """Start at the first odometry: it continues that of the session, or the robot may be anywhere in its map."""
        self._has_odometry = True
        if self._resumed is None:
            self._preprocessor.odometry = self._journal.start_odometry_segment()
            return
        self._publisher.publish_map(first.stamp, self.slam_state.mapper)
        self._preprocessor.odometry = self._journal.segments.histories[-1]
        if self._velocity is not None or not self._journal.segments.is_continued_by(first):
            self._process_queue(len(self._resumed.queued_scans))
            self._preprocessor.odometry = self._journal.start_odometry_segment()
            self._estimator.begin_part(self.slam_state.pose, first.pose, kidnapped=True)
            self._publish_state(first.stamp, self._localisation.handle(LocalisationEvent.STARTED_ANYWHERE))

    def _place(self, scan: ProcessedScan, pose: se2.Pose) -> None:
        """Move the robot to the pose that was set, if the scan fits near it."""
        self._initial_pose = None
        if not self._estimator.place(pose, scan):
            text = "the initial pose is not used: the scan does not fit near it"
            self._publisher.publish(Notice(scan.stamp, text))
            return
        self._publisher.publish(Notice(scan.stamp, "the robot is placed at the initial pose"))
        if self._localisation.lost:
            self._publish_state(scan.stamp, self._localisation.handle(LocalisationEvent.RELOCALISED))

    def _update_localisation(self, stamp: float, result: ScanResult) -> None:
        """Update the localisation status by a scan: lost, recognised, placed by odometry, or tracked."""
        if result.began_part:
            self._publisher.publish(Notice(stamp, "the pose is lost: a new part of the map begins here"))
            self._publisher.publish_map(stamp, self.slam_state.mapper)
            self._publish_state(stamp, self._localisation.handle(LocalisationEvent.TRACKING_LOST))
        elif result.joined is not None:
            self._publisher.publish(Relocalised(stamp, self.slam_state.pose.copy(), result.joined))
            self._publisher.publish(Notice(stamp, "relocalised in the map", "INFO"))
            self._publish_state(stamp, self._localisation.handle(LocalisationEvent.RELOCALISED))
        elif result.retracted is not None and result.retracted.joins:
            self._publish_state(stamp, self._localisation.handle(LocalisationEvent.TRACKING_LOST))
        elif not self._localisation.lost:
            self._publish_state(stamp, self._localisation.update(result.tracking))
        elif self._estimator.placed_by_odometry:
            text = "the place is not in the map near the pose from odometry; it is mapped as a new place"
            self._publisher.publish(Notice(stamp, text, "INFO"))
            self._publish_state(stamp, self._localisation.handle(LocalisationEvent.PLACED_BY_ODOMETRY))

    def _publish_state(self, stamp: float, state: LocalisationState | None) -> None:
        """Publish a localisation state if it has changed."""
        if state is not None:
            self._statistics.states.append((stamp, state))
            self._publisher.publish_state(stamp, state)

    # --- output

    @property
    def slam_state(self) -> SlamState:
        """Current state of the estimate: pose, trajectory and the map under construction."""
        return self._estimator.result

    @property
    def pose(self) -> se2.Pose:
        """Pose of the base [x, y, heading] in the map at the last scan; see `state` for how well it is known."""
        return self._estimator.state.pose.copy()

    @property
    def state(self) -> LocalisationState:
        """Localisation status: OK, DEGENERATE in one direction, or LOST."""
        return self._localisation.state

    @property
    def walls(self) -> MapWalls:
        """Current walls, without covariances, which cost time: `finish` returns them."""
        return map_features(self.slam_state.mapper)[0]

    @property
    def corners(self) -> MapCorners:
        """Current corners, without covariances."""
        return map_features(self.slam_state.mapper)[1]

    @property
    def session(self) -> StoredSession:
        """Complete estimate, to be stored and continued. Raises SlamError before `finish`."""
        if self._session is None:
            raise SlamError("the session is available after finish() only")
        return self._session

    def snapshot(self) -> RunSnapshot:
        """Return a copy of the run, to be saved while it goes on. Raises MapError before the first keyframe."""
        journal, state = self._journal, self.slam_state
        if not journal.segments.starts or not state.mapper.keyframe_count:
            raise MapError("nothing is mapped yet")
        session = self._stored(state.copy(), release=False)
        session.scans, session.queued_scans = list(journal.scans), self._preprocessor.queued
        session.starts = list(journal.segments.starts)
        session.odometry = [history.copy() for history in journal.segments.histories]
        summary = self._summary(journal.scans[-1].stamp)
        return RunSnapshot(session, summary, journal.resumed_at if self._frozen else -np.inf)

    def keyframe_covariance(self, index: int) -> Floats:
        """Return the covariance (3, 3) of a keyframe's pose in its own frame (metres, metres, radians)."""
        return self.slam_state.mapper.keyframe_covariance(index)

    # --- end of the run

    def finish(self) -> Finished:
        """Process the queued scans, settle the map, and return map and trajectory with marginal covariances.

        Raises MapError if there was nothing to map.
        """
        if not self._preprocessor.scans:
            raise MapError("no laser scan in it, so there is nothing to map")
        if not self._has_odometry:
            raise MapError(f"{self._preprocessor.scans} scans, but no odometry; add --no-odometry to map without")
        session = self._session_with_queue()
        self._process_queue()
        self._leave_out_unknown_session()
        self._session = session or self._stored(self.slam_state.copy())
        if not self._frozen:
            self._statistics.merged_walls += self.slam_state.mapper.converge()
        end = self._journal.scans[-1].stamp
        self._report_rejected_loops(end, ended=True)
        summary = self._summary(end) | self._refine_or_match()
        if self._refine:
            self._session = self._stored(self.slam_state)
        state, journal = self.slam_state, self._journal
        stamps, poses = journal.segments.trajectory(state.trajectory, state.mapper.keyframe_poses)
        if self._frozen:
            stamps, poses = stamps[stamps > journal.resumed_at], poses[stamps > journal.resumed_at]
        self._publisher.publish_residuals(float(stamps[-1]), state.mapper)
        result = final_result(state, (stamps, poses), summary | {"suspects": self._check()})
        self._publisher.publish(result)
        return result

    def _summary(self, end: float) -> dict[str, object]:
        """Return the summary of the run up to the stamp `end` as plain data."""
        gyroscope = self._gyroscope
        found = {"gyroscope": {"bias": round(gyroscope.bias, 6), "sigma": round(gyroscope.sigma, 6)}}
        summary = run_summary(self._preprocessor, self.slam_state, self._statistics, end)
        return summary | (found if gyroscope.present else {})

    def _check(self) -> list[dict[str, object]]:
        """Check the finished run against itself; publish the findings and return the summary's part."""
        state, journal = self.slam_state, self._journal
        placed = state.trajectory.at_scans(state.mapper.keyframe_poses)
        drive = drive_of(journal.scans, journal.segments.starts, placed, state.odometry_model)
        suspects = [*unconnected_parts(state.mapper, state.keyframe_stamps), *find_suspects(drive)]
        if self._velocity is not None:
            suspects += unconstrained_stretches(state.trajectory, state.mapper.keyframe_poses)
        if self._frozen:
            suspects = [suspect for suspect in suspects if suspect.stamp > journal.resumed_at]
        self._publisher.publish_suspects(suspects, state.keyframe_stamps)
        return [suspect.row() for suspect in suspects]

    def _process_queue(self, count: int = sys.maxsize) -> None:
        """Process at most `count` queued scans without odometry to cover them."""
        while count > 0 and (scan := self._preprocessor.next_scan(flush=True)) is not None:
            self._process_scan(scan)
            count -= 1

    def _session_with_queue(self) -> StoredSession | None:
        """Return the session with the queued scans still in the queue, as if the run had not ended.

        None if no scan is queued, or if the robot was never recognised in an earlier session, which the end decides on.
        """
        queued = self._preprocessor.queued
        if self._is_unknown_place or not queued or not self.slam_state.mapper.keyframe_count:
            return None
        session = self._stored(self.slam_state.copy())
        session.scans, session.queued_scans = list(self._journal.scans), queued
        return session

    @property
    def _is_unknown_place(self) -> bool:
        """True if nothing of this run is in a place that is known to be in the map of the earlier session."""
        journal, parts = self._journal, self._estimator.state.mapper.landmarks.parts
        if self._resumed is None or not journal.in_new_odometry_segment:
            return False
        if self._frozen:
            return not journal.any_tracked(self.slam_state.trajectory)
        keyframes = np.flatnonzero(np.array(self.slam_state.keyframe_stamps) > journal.stamp_before)
        if not len(keyframes):  # placed in the map, and only in familiar places since
            return not journal.any_tracked(self.slam_state.trajectory)
        return not parts.connected(keyframes, 0).any()

    def _leave_out_unknown_session(self) -> None:
        """Map this run alone if it was never recognised in the map of the earlier session.

        Raises MapError if that map is frozen.
        """
        journal = self._journal
        if not self._is_unknown_place:
            return
        if self._frozen:
            raise MapError("the robot was never relocalised in the map of the session")
        journal.drop_earlier_session()
        self._resumed = None
        self._estimator = Estimator(SlamState(self.config))
        for scan in journal.scans:
            result = self._estimator.process(scan)
            for decision in (result.update.loop if result.update else None, result.retracted):
                if decision is not None:
                    self._statistics.add_loop(scan.stamp, decision)
        stamp = journal.scans[-1].stamp
        text = "never relocalised in the map of the session: that map is left out of the results"
        self._publisher.publish(Notice(stamp, text))
        self._publisher.publish_map(stamp, self.slam_state.mapper)

    def _refine_or_match(self) -> dict[str, object]:
        """Match all scans to the final map, after refining the map if that is wanted; return the summary's part."""
        state, journal = self.slam_state, self._journal
        stamp = journal.scans[-1].stamp
        if state.mapper.keyframe_count < 2:
            return {}
        history = journal.history(state)
        try:
            if not self._refine or self._frozen:
                history = journal.without_familiar_features(history)  # the result must not depend on what is kept
                state.trajectory = match_trajectory(state.mapper, history, state.odometry_model)
                return {}
            refined = refine(state.mapper, history, state.odometry_model)
        except MapError as error:
            self._publisher.publish(Notice(stamp, f"the scans are not matched to the final map: {error}"))
            return {}
        refined.mapper.recompute_pose_covariances()
        keyframes = {k: journal.scans[row] for k, row in enumerate(history.keyframes.tolist())}
        state.replace_map(
            refined.mapper, refined.trajectory, PoseFix(refined.poses[-1], journal.scans[-1].odometry), keyframes
        )
        self._publisher.publish_map(stamp, state.mapper)
        return {"refinement": refined.summary}

    def _stored(self, state: SlamState, *, release: bool = True) -> StoredSession:
        resumed, journal = self._resumed, self._journal
        if release:
            state.mapper.gauge.release(state.mapper)
        return StoredSession(
            config=self.config,
            slam_state=state,
            scans=journal.scans,
            odometry=journal.segments.histories,
            starts=journal.segments.starts,
            sigma_range=self._preprocessor.sigma_range,
            recordings=[] if resumed is None else list(resumed.recordings),
            loop_decisions=[*(() if resumed is None else resumed.loop_decisions), *self._statistics.loops],
        )


def _motion_since(before: se2.Pose | None, tracking: TrackingResult) -> tuple[se2.Pose | None, Floats]:
    """Return the motion from the pose of the last scan to that of this one, and the covariance (3, 3) of a pose.

    The motion is None if one of the scans was not matched.
    """
    matched = tracking.status in (TrackingStatus.TRACKED, TrackingStatus.TENTATIVE)
    return se2.between(before, tracking.pose) if before is not None and matched else None, tracking.covariance
