"""SLAM from messages to map: `Slam.add` takes the messages, `Slam.finish` returns map and trajectory."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from drivers import se2
from drivers.messages import GroundTruth, InitialPose, Message, Odometry, delay_odometry, on_clock_of_first

from .config import Config
from .errors import MapError, SlamError
from .estimation.estimator import Estimator
from .estimation.journal import Journal
from .estimation.map_view import final_result, map_features
from .estimation.plan_prior import PlanPrior
from .estimation.slam_state import INITIAL_POSE_SIGMAS, SlamState
from .estimation.stage_timer import StageTimer
from .estimation.wall_bends import settle_wall_bends
from .events import Finished, GroundTruthReceived, Notice, Sink
from .geometry.segments import Floats
from .localisation.state import LocalisationEvent, LocalisationState
from .localisation_report import LocalisationReport
from .loop_closure.agreement import LoopAgreement
from .mapping.convergence import converge
from .mapping.map_features import MapCorners, MapWalls
from .mapping.plan_map import PlanMap
from .odometry.motion_source import MotionSource
from .preprocessing.preprocessor import Preprocessor, ProcessedScan
from .preprocessing.scan_queue import ScanPair
from .publisher import Publisher
from .run_end import check_run, find_scan_delay, is_unknown_place, map_alone, refine_or_match, settle_plan
from .run_snapshot import RunSnapshot
from .run_statistics import RunStatistics, run_summary

if TYPE_CHECKING:
    from .io.sessions import StoredSession


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
        plan: PlanMap | None = None,
    ) -> None:
        """Create an empty map, or continue a session.

        refine             refine the whole map offline in `finish`
        keep_all_features  keep the features of scans in familiar places too, and of a robot that stands, so that the
                           session can be refined later; memory then grows with time. Implied by `refine`
        loops              search for loop closures in another way than the default
        resumed            session to continue: directly if odometry is continuous, else after relocalisation in its map
        frozen             keep the map of the session unchanged and only estimate the trajectory in it
        start              roughly known pose [x, y, heading] of the base in the map of the session, or in the plan, at
                           the first scan; without it the robot may be anywhere
        plan               plan of the building: once the map is recognised in it, it is in the plan's frame, and walls
                           that agree with the plan are supported by it. Not with `resumed`
        """
        if plan is not None and resumed is not None:
            raise MapError("a plan cannot be used together with a session that is continued")
        self._initial_pose = start if plan is None else None
        self.config = config or Config()
        self._refine, self._frozen = refine, frozen
        self._resumed = resumed
        self._publisher = Publisher(sinks)
        self._statistics = RunStatistics()
        self._has_odometry = False
        self._session: StoredSession | None = None
        self._motions = MotionSource(self.config.odometry)
        noise = (None, None) if resumed is None else (resumed.sigma_range, resumed.second_sigma_range)
        self._preprocessor = Preprocessor(self.config, *noise)
        keep = refine or keep_all_features
        if resumed is None:
            self._estimator = Estimator(SlamState(self.config, loops))
            self._journal = Journal(keep_all_features=keep)
            self.slam_state.plan = None if plan is None else PlanPrior(plan, start, np.diag(INITIAL_POSE_SIGMAS**2))
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
        self._localisation = LocalisationReport(
            self.slam_state.odometry_model.unobserved_sigma, self._publisher, self._statistics
        )
        if frozen:
            self.slam_state.freeze()

    # --- input

    def add(self, message: Message) -> None:
        """Add the next message. A scan is processed once odometry covers its sweep.

        Scans must come in the order of their stamps, and odometry too; a scan may come after later odometry.
        """
        message = delay_odometry(message, self.config.lidar.delay or 0.0)
        message = on_clock_of_first(message, self.config.second_lidar_delay)
        if isinstance(message, GroundTruth):
            self._publisher.publish(GroundTruthReceived(message.stamp, message.pose))
            return
        if isinstance(message, InitialPose):
            self._initial_pose = message.pose
            return
        for measurement in self._motions.measurements(message):
            if isinstance(measurement, Odometry) and not self._has_odometry:
                self._start(measurement)
            self._preprocessor.add(measurement)
            while (scan := self._preprocessor.next_scan()) is not None:
                self._process_scan(scan)

    def _process_scan(self, scan: ScanPair) -> None:
        """De-skew a scan, extract features, track the pose, update the map, and publish the results."""
        timer = StageTimer()
        processed = self._preprocessor.process(scan, self.slam_state.odometry_model)
        timer.lap("features")
        self._journal.add(processed)
        before = self._estimator.state.matched_pose if self._motions.learns else None
        if self._initial_pose is not None:
            self._place(processed, self._initial_pose)
            before = None
        result = self._estimator.process(processed, timer)
        if self._motions.learns:
            tracking = result.tracking
            self._motions.correct(processed.stamp, tracking.motion_since(before), tracking.covariance)
        if self._motions.predicted:
            result = replace(result, tracking=replace(result.tracking, slipped=False))  # there is nothing that can slip
        if self._frozen:
            self._journal.mark_localised()
        elif self.slam_state.in_familiar_place:
            self._journal.mark_last_familiar()
        self._journal.mark_standing(self._estimator.state.keyframe_stamps)
        self._statistics.add_tracking(result.tracking)
        self._statistics.lost_scans += self._localisation.lost
        state = self.slam_state
        self._publisher.publish_tracking(processed, result.tracking, state.mapper, state.odometry_model)
        if result.update is not None:
            self._statistics.add_keyframe(processed.stamp, result.update, timer)
            self._publisher.publish_keyframe(
                processed, result.mapper, result.update, self._preprocessor.sigma_range, timer
            )
            self._report_rejected_loops(processed.stamp)
        if result.in_plan:
            self._report_plan(processed.stamp)
        if result.retracted is not None:
            self._statistics.add_loop(processed.stamp, result.retracted)
            self._publisher.publish_loop(result.retracted, processed.stamp, self.slam_state.mapper, result.mapper)
        self._localisation.update(processed.stamp, result, self._estimator)

    def _report_plan(self, stamp: float) -> None:
        """Publish that the map was recognised in the plan, and the map in its new frame."""
        self._publisher.publish(Notice(stamp, "recognised in the plan", "INFO"))
        self._publisher.publish_map(stamp, self.slam_state.mapper)

    def _report_rejected_loops(self, stamp: float, *, ended: bool = False) -> None:
        """Count and publish the hypotheses of loops that were given up; if the run has `ended`, also all others."""
        state = self.slam_state
        for decision in state.loops.take_rejected(ended=ended):
            self._statistics.add_loop(state.keyframe_stamps[decision.keyframe], decision)
            self._publisher.publish_rejected_loop(decision, stamp, state.mapper)

    # --- start

    def _start(self, first: Odometry) -> None:
        """Start at the first odometry: it continues that of the session, or the robot may be anywhere in its map."""
        self._has_odometry = True
        if self._resumed is None:
            self._preprocessor.odometry = self._journal.start_odometry_segment()
            return
        self._publisher.publish_map(first.stamp, self.slam_state.mapper)
        self._preprocessor.odometry = self._journal.segments.histories[-1]
        if self._motions.predicted or not self._journal.segments.is_continued_by(first):
            self._process_queue(sum(not scan.lidar for scan in self._resumed.queued_scans))
            self._preprocessor.odometry = self._journal.start_odometry_segment()
            self._estimator.begin_part(self.slam_state.pose, first.pose, kidnapped=True)
            self._localisation.handle(first.stamp, LocalisationEvent.STARTED_ANYWHERE)

    def _place(self, scan: ProcessedScan, pose: se2.Pose) -> None:
        """Move the robot to the pose that was set, if the scan fits near it."""
        self._initial_pose = None
        if not self._estimator.place(pose, scan):
            text = "the initial pose is not used: the scan does not fit near it"
            self._publisher.publish(Notice(scan.stamp, text))
            return
        self._publisher.publish(Notice(scan.stamp, "the robot is placed at the initial pose"))
        if self._localisation.lost:
            self._localisation.handle(scan.stamp, LocalisationEvent.RELOCALISED)

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
        session.scans, session.queued_scans = journal.scans.copy(), self._preprocessor.queued
        session.starts = list(journal.segments.starts)
        session.odometry = [history.copy() for history in journal.segments.histories]
        summary = self._summary(journal.scans[-1].stamp)
        return RunSnapshot(session, summary, journal.resumed_at if self._frozen else -np.inf)

    def keyframe_covariance(self, index: int) -> Floats:
        """Return the covariance (3, 3) of a keyframe's pose in its own frame (metres, metres, radians)."""
        return self.slam_state.mapper.covariances.of_keyframe(index)

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
        self.slam_state.local_field.begin_part()  # frees some megabytes: no scan is matched with it any more
        if not self._frozen:
            self._statistics.merged_walls += converge(self.slam_state.mapper)
            settle_plan(self.slam_state, self._journal, self._publisher)
        end = self._journal.scans[-1].stamp
        self._report_rejected_loops(end, ended=True)
        state, journal = self.slam_state, self._journal
        summary = self._summary(end)
        history = journal.history(state)
        summary |= refine_or_match(state, journal, history, self._publisher, wanted=self._refine and not self._frozen)
        summary["wall_bends"] = settle_wall_bends(state.mapper, history)
        delay = find_scan_delay(state, journal)
        summary["scan_delay"] = None if delay is None else delay.row()
        if self._refine:
            self._session = self._stored(state)
        stamps, poses = journal.segments.trajectory(state.trajectory, state.mapper.keyframe_poses)
        if self._frozen:
            stamps, poses = stamps[stamps > journal.resumed_at], poses[stamps > journal.resumed_at]
        self._publisher.publish_residuals(float(stamps[-1]), state.mapper)
        after = journal.resumed_at if self._frozen else -np.inf
        suspects = check_run(state, journal, self._publisher, after=after, predicted=self._motions.predicted)
        result = final_result(state, (stamps, poses), summary | {"suspects": suspects})
        self._publisher.publish(result)
        return result

    def _summary(self, end: float) -> dict[str, object]:
        """Return the summary of the run up to the stamp `end` as plain data."""
        return run_summary(self._preprocessor, self.slam_state, self._statistics, end) | self._motions.summary()

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
        session.scans, session.queued_scans = self._journal.scans.copy(), queued
        return session

    @property
    def _is_unknown_place(self) -> bool:
        """True if nothing of this run is in a place that is known to be in the map of the earlier session."""
        return self._resumed is not None and is_unknown_place(self._estimator, self._journal, frozen=self._frozen)

    def _leave_out_unknown_session(self) -> None:
        """Map this run alone if it was never recognised in the map of the earlier session.

        Raises MapError if that map is frozen.
        """
        if not self._is_unknown_place:
            return
        if self._frozen:
            raise MapError("the robot was never relocalised in the map of the session")
        self._resumed = None
        self._estimator = map_alone(self.config, self._journal, self._statistics, self._publisher)

    def _stored(self, state: SlamState, *, release: bool = True) -> StoredSession:
        from .io.sessions import StoredSession  # only here: a recording is read without the libraries of tables

        resumed, journal = self._resumed, self._journal
        if release:
            state.mapper.gauge.release(state.mapper)
            state.mapper.graph.solver.dismiss_isam()
        return StoredSession(
            config=self.config,
            slam_state=state,
            scans=journal.scans,
            odometry=journal.segments.histories,
            starts=journal.segments.starts,
            sigma_range=self._preprocessor.sigma_range,
            second_sigma_range=self._preprocessor.second_sigma_range,
            recordings=[] if resumed is None else list(resumed.recordings),
            loop_decisions=[*(() if resumed is None else resumed.loop_decisions), *self._statistics.loops],
        )
